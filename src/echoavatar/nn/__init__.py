"""Building blocks of the networks: the streaming contract and causal attention. May import `checkpoint` and below."""

from .attention import AttentionState, CausalAttention, lookback_mask, rotary
from .blocks import CausalBlock, FullBlock, Mlp
from .stream import StateT, StreamingModule, StreamState, write_rows

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
