"""Sound: the codec's sizes, streaming resampler, level control, files. May import `nn` and below."""

from importlib import import_module
from typing import TYPE_CHECKING

from .io import StreamResampler, read_audio, stream_audio, write_wav

if TYPE_CHECKING:
    from .codec_config import CodecConfig
    from .level import LevelControl, LevelState

__all__ = ["CodecConfig", "LevelControl", "LevelState", "StreamResampler", "read_audio", "stream_audio", "write_wav"]
_HOMES = {"CodecConfig": ".codec_config", "LevelControl": ".level", "LevelState": ".level"}


def __getattr__(name: str) -> object:
    """Import what compiles when it is first asked for: clients only read sound."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name], __name__), name)
