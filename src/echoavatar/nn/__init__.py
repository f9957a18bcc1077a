"""Building blocks of the networks: the streaming contract and causal attention. May import `checkpoint` and below."""

from .stream import StateT, StreamingModule, StreamState, write_rows

__all__ = ["StateT", "StreamState", "StreamingModule", "write_rows"]
