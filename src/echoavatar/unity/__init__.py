"""The authors' Unity projects served as they are: their motion messages out, their audio and actions in, over TCP.

May import `engine`, `reference` and below.
"""

from .frames import Block
from .message import Messages
from .serve import UnitySettings, serve_unity

__all__ = ["Block", "Messages", "UnitySettings", "serve_unity"]
