"""Building blocks of the networks: the streaming contract and causal attention. May import `checkpoint` and below.

What needs torch is imported from its own module: the kernels of `motion` do without.
"""

from .state import StreamState

__all__ = ["StreamState"]
