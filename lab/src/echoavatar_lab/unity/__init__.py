"""A server for the authors' Unity projects: their motion messages out, audio and actions in, over TCP.

May import `reference` and below.
"""

from .serve import UnitySettings, serve_unity

__all__ = ["UnitySettings", "serve_unity"]
