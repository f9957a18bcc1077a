"""Sound: codec, streaming resampler, level control, files. May import `quantize`, `nn` and below."""

from importlib import import_module
from typing import TYPE_CHECKING

from .io import StreamResampler, read_audio, stream_audio, write_wav

if TYPE_CHECKING:
    from .codec import AudioCodec
    from .codec_config import CodecConfig
    from .level import LevelControl, LevelState

__all__ = [
    "AudioCodec",
    "CodecConfig",
    "LevelControl",
    "LevelState",
    "StreamResampler",
    "read_audio",
    "stream_audio",
    "write_wav",
]
_HOMES = {"AudioCodec": ".codec", "CodecConfig": ".codec_config", "LevelControl": ".level", "LevelState": ".level"}


def __getattr__(name: str) -> object:
    """Import what needs torch or compiles when it is first asked for: clients only read sound."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name], __name__), name)
