"""Audio codes to motion codes: the model and its streaming step. May import `tokens`, `noise` and below."""

from importlib import import_module
from typing import TYPE_CHECKING

from .config import GeneratorConfig, qwen_half_billion

if TYPE_CHECKING:
    from .model import Generator
    from .stream import open_stream

__all__ = ["Generator", "GeneratorConfig", "open_stream", "qwen_half_billion"]
_HOMES = {"Generator": ".model", "open_stream": ".stream"}


def __getattr__(name: str) -> object:
    """Import what needs torch when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name], __name__), name)
