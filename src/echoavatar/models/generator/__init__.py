"""Audio codes to motion codes without torch: sizes, and the compiled step. May import `tokens`, `noise` and below."""

from .config import GeneratorConfig, qwen_half_billion

__all__ = ["GeneratorConfig", "qwen_half_billion"]
