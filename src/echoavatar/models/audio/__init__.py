"""Sound: codec, streaming resampler, level control, files. May import `quantize`, `nn` and below."""

from .codec import AudioCodec, nearest_codes
from .config import CodecConfig
from .io import read_audio, stream_audio, write_wav
from .level import LevelControl, LevelState
from .resample import StreamResampler, as_mono
from .stream import NetworkState

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
