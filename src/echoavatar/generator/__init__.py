"""Audio codes to motion codes: the model, streaming, training."""

from .config import GeneratorConfig, qwen_half_billion
from .model import Generator
from .stream import GeneratorStream, InterleavedStream, PrefixStream, open_stream

__all__ = [
    "Generator",
    "GeneratorConfig",
    "GeneratorStream",
    "InterleavedStream",
    "PrefixStream",
    "open_stream",
    "qwen_half_billion",
]
