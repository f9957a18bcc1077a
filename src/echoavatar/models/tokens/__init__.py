"""Codes and vocabulary ids, the grammar of sequences. May import `tokenizer` and below."""

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
    "sequence_order",
]
