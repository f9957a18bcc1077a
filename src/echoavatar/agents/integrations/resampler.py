"""Resample an agent's speech from any rate to the session's, without a seam between blocks."""

from typing import Any

import numpy as np
import soxr
from jaxtyping import Shaped

from echoavatar.timing import SAMPLE_RATE_HZ


class SpeechResampler:
    """Resamples one stream of speech."""

    def __init__(self) -> None:
        self._rate = SAMPLE_RATE_HZ
        self._stream: Any = None

    def push(self, pcm: Shaped[np.ndarray, " s"], rate: int) -> Shaped[np.ndarray, " t"]:
        """Resample a block; some of its samples may come out with the next block."""
        if rate != self._rate:
            self._rate = rate
            self._stream = (
                None if rate == SAMPLE_RATE_HZ else soxr.ResampleStream(rate, SAMPLE_RATE_HZ, 1, dtype="int16")
            )
        return pcm if self._stream is None else self._stream.resample_chunk(pcm)

    def flush(self) -> Shaped[np.ndarray, " t"]:
        """The rest of the stream; the next block starts another one."""
        rest = np.zeros(0, np.int16)
        if self._stream is not None:
            rest = self._stream.resample_chunk(rest, last=True)
            self._stream.clear()
        return rest

    def reset(self) -> None:
        """Drop samples that have not come out yet."""
        if self._stream is not None:
            self._stream.clear()
