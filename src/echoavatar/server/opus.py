"""Sound as Opus, a sixth of the bytes of PCM, aligned with motion to the sample.

Opus frames of 20 ms do not divide a chunk, so a message carries the frames that are complete; the rest goes with the
next chunk. A decoder gives back each sample `PRE_SKIP` samples late. The clock on each message accounts for that.
"""

from collections.abc import Sequence
from functools import lru_cache

import av
import numpy as np
from av.audio.codeccontext import AudioCodecContext
from jaxtyping import Float, Int16

from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import PackedSound, SoundFormat

BITS_A_SECOND = 28_000
PACKET = SAMPLE_RATE_HZ // 50
PRE_SKIP = 156  # samples at 24 kHz; libopus states 312 at 48 kHz, and `is_available` checks it
_OPTIONS = {"application": "audio", "frame_duration": "20", "vbr": "on", "compression_level": "5"}


def choose(wanted: Sequence[str]) -> SoundFormat:
    """How a client gets its sound: Opus if it plays that and this machine can make it, else PCM."""
    return "opus" if "opus" in wanted and is_available() else "pcm"


@lru_cache(maxsize=1)
def is_available() -> bool:
    """Whether PyAV here has libopus, with the delay that we count on."""
    try:
        head = _encoder().extradata or b""
    except (av.FFmpegError, ValueError):
        return False
    return int.from_bytes(head[10:12], "little") * SAMPLE_RATE_HZ == PRE_SKIP * 48_000


def _encoder() -> AudioCodecContext:
    encoder = av.CodecContext.create("libopus", "w")
    assert isinstance(encoder, AudioCodecContext)
    encoder.sample_rate, encoder.layout, encoder.format = SAMPLE_RATE_HZ, "mono", "s16"
    encoder.bit_rate, encoder.options = BITS_A_SECOND, dict(_OPTIONS)
    encoder.open()
    return encoder


class OpusPacker:
    """Encodes the chunks of one session, in the order in which they are sent."""

    def __init__(self) -> None:
        self._encoder: AudioCodecContext | None = None
        self._waiting: Int16[np.ndarray, " s"] = np.zeros(0, np.int16)
        self._epoch = self._next = self._packed = 0  # clock of the sample expected, and of the next packet's first

    def pack(self, samples: Float[np.ndarray, " s"], *, at: int, epoch: int, seg: int) -> PackedSound:
        """Encode a chunk at 24 kHz. A clock or epoch other than expected, as after an interrupt, begins anew."""
        skip = 0
        if self._encoder is None or (at, epoch) != (self._next, self._epoch):
            self._encoder, self._waiting = _encoder(), np.zeros(0, np.int16)
            self._packed, self._epoch, skip = at, epoch, PRE_SKIP
        pcm = np.rint(np.clip(samples, -1, 1) * 32_767).astype(np.int16)
        self._waiting = np.concatenate([self._waiting, pcm])
        self._next = at + len(samples)
        first, packets = self._packed - PRE_SKIP + skip, []
        while len(self._waiting) >= PACKET:
            frame = av.AudioFrame.from_ndarray(self._waiting[None, :PACKET], format="s16", layout="mono")
            frame.sample_rate, frame.pts = SAMPLE_RATE_HZ, self._packed
            packets += [bytes(packet) for packet in self._encoder.encode(frame)]
            self._waiting = self._waiting[PACKET:]
            self._packed += PACKET
        return PackedSound(at=first, epoch=epoch, seg=seg, skip=skip, packets=tuple(packets))
