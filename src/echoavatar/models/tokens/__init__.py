"""Codes and vocabulary ids, the grammar of sequences, token corruption. May import `tokenizer` and below."""

from .corruption import corrupt_hierarchically, corrupt_uniformly
from .layout import PARTS, REFERENCE_LAYOUT, TokenLayout
from .sequence import Depth, Interleaved, Prefix, SequenceOrder, Sequences, sequence_order

__all__ = [
    "PARTS",
    "REFERENCE_LAYOUT",
    "Depth",
    "Interleaved",
    "Prefix",
    "SequenceOrder",
    "Sequences",
    "TokenLayout",
    "corrupt_hierarchically",
    "corrupt_uniformly",
    "sequence_order",
]
