"""Audio codes to motion codes: the model and its streaming step. May import `tokens` and below."""

from .config import GeneratorConfig, qwen_half_billion
from .model import Generator
from .stream import open_stream

__all__ = ["Generator", "GeneratorConfig", "open_stream", "qwen_half_billion"]
