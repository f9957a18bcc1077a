"""Sound: codec, streaming resampler, level control, files. May import `quantize`, `nn` and below."""

from importlib import import_module
from typing import TYPE_CHECKING

from .io import StreamResampler, as_mono, read_audio, stream_audio, write_wav

if TYPE_CHECKING:
    from .codec import AudioCodec, nearest_codes
    from .codec_config import CodecConfig
    from .level import LevelControl, LevelState
    from .network import NetworkState

__all__ = [
    "AudioCodec",
    "CodecConfig",
    "NetworkState",
    "LevelControl",
    "LevelState",
    "StreamResampler",
    "as_mono",
    "nearest_codes",
    "read_audio",
    "stream_audio",
    "write_wav",
]
_HOMES = {"LevelControl": ".level", "LevelState": ".level", "CodecConfig": ".codec_config", "NetworkState": ".network"}


def __getattr__(name: str) -> object:
    """Import a network when it is first asked for: clients that read sound need no torch."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES.get(name, ".codec"), __name__), name)
