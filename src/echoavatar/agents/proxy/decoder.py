"""Decode the audio of Realtime events to 24 kHz int16: PCM of any rate, mu-law and A-law (ITU-T G.711)."""

import numpy as np
import soxr
from jaxtyping import Int16, UInt8

from echoavatar.timing import SAMPLE_RATE_HZ

Pcm = Int16[np.ndarray, " _s"]  # blocks of any length, also beside each other


class Decoder:
    """Decodes one stream of one format."""

    def __init__(self, kind: str = "pcm", rate: int = SAMPLE_RATE_HZ) -> None:
        self._kind = kind
        self._rest = b""  # an incomplete sample at the end of the last block
        self._stream = (
            None
            if rate == SAMPLE_RATE_HZ
            else soxr.ResampleStream(rate, SAMPLE_RATE_HZ, 1, dtype="int16", quality="HQ")
        )

    def push(self, data: bytes, *, is_last: bool = False) -> Pcm:
        """Decode the next bytes; `is_last` also flushes the resampler."""
        if self._kind == "pcm":
            data = self._rest + data
            whole = len(data) // 2 * 2
            self._rest = data[whole:]
            samples = np.frombuffer(data[:whole], "<i2")
        else:
            samples = _TABLES[self._kind][np.frombuffer(data, np.uint8)]
        if self._stream is None:
            return samples
        made: Pcm = self._stream.resample_chunk(samples, last=is_last)
        return made


def _ulaw(code: UInt8[np.ndarray, " n"]) -> Pcm:
    """Mu-law: 8 segments of 16 steps, inverted bits, bias 33 at 14 bits."""
    code = ~code
    segment, step = (code >> 4) & 7, code & 15
    size = (((2 * step.astype(np.int32) + 33) << segment) - 33) * 4
    return np.where(code & 128, -size, size).astype(np.int16)


def _alaw(code: UInt8[np.ndarray, " n"]) -> Pcm:
    """A-law: the first two segments are linear; every other bit is inverted."""
    code = code ^ 0x55
    segment, step = ((code >> 4) & 7).astype(np.int32), (code & 15).astype(np.int32)
    size = np.where(segment == 0, 2 * step + 1, (2 * step + 33) << np.maximum(segment - 1, 0)) * 8
    return np.where(code & 128, size, -size).astype(np.int16)


_CODES = np.arange(256, dtype=np.uint8)
_TABLES = {"ulaw": _ulaw(_CODES), "alaw": _alaw(_CODES)}
