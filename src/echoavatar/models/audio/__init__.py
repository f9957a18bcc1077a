"""Sound: codec, streaming resampler, level control, files. May import `quantize`, `nn` and below."""

from .codec import AudioCodec, nearest_codes
from .io import StreamResampler, as_mono, read_audio, stream_audio, write_wav
from .level import LevelControl, LevelState
from .network import CodecConfig, NetworkState

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
