"""Building blocks of the networks: the streaming contract and causal attention. May import `checkpoint` and below."""

from importlib import import_module
from typing import TYPE_CHECKING

from .state import StreamState

if TYPE_CHECKING:
    from .attention import AttentionState, CausalAttention, lookback_mask, rotary
    from .blocks import CausalBlock, FullBlock, Mlp
    from .stream import StateT, StreamingModule, write_rows

__all__ = [
    "AttentionState",
    "CausalAttention",
    "CausalBlock",
    "FullBlock",
    "Mlp",
    "StateT",
    "StreamState",
    "StreamingModule",
    "lookback_mask",
    "rotary",
    "write_rows",
]
_BLOCKS = ("CausalBlock", "FullBlock", "Mlp")
_STREAM = ("StateT", "StreamingModule", "write_rows")


def __getattr__(name: str) -> object:
    """Import what needs torch when it is first asked for: the kernels of `motion` do without."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = ".blocks" if name in _BLOCKS else ".stream" if name in _STREAM else ".attention"
    return getattr(import_module(home, __name__), name)
