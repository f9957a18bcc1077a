"""How networks run: state, compiled kernels, exported graphs, and the door to the lab's torch.

May import `errors` and `cache`.
"""

from .state import StreamState

__all__ = ["StreamState"]
