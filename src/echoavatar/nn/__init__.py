"""How networks run: state, compiled kernels, exported graphs, and the torch modules of echoavatar-lab.

May import `stored`, `errors` and `cache`.
"""

from .state import StreamState

__all__ = ["StreamState"]
