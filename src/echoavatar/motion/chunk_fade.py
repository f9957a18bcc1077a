"""A fade that goes on from chunk to chunk, and repeats itself where a session goes back."""

import numpy as np
from jaxtyping import Float

from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize

KEPT = 64  # chunks whose last value is remembered


class ChunkFade:
    """A share from 0 to 1 that rises in `rise_s` seconds while it is wanted and falls in `fall_s` while it is not.

    The value at the end of each chunk is kept by chunk number. A chunk that is made again thus starts from the same
    value as the first time.
    """

    def __init__(self, rise_s: float, fall_s: float, *, start: float = 0.0, chunk: ChunkSize = CHUNK) -> None:
        """`start` is the value before chunk 0."""
        self._rise, self._fall = 1 / (rise_s * FRAME_RATE_HZ), -1 / (fall_s * FRAME_RATE_HZ)
        self._frames = chunk.frames
        self._start = start
        self._ends: dict[int, float] = {}  # by chunk: the share in its last frame

    def shares(self, chunk: int, *, is_wanted: bool) -> Float[np.ndarray, " t"]:
        """The share in each frame of a chunk, a straight line that is held at 0 and 1."""
        begin = self._start if chunk == 0 else self._ends.get(chunk - 1, 0.0)
        pace = self._rise if is_wanted else self._fall
        path: np.ndarray = np.clip(begin + pace * np.arange(1, self._frames + 1), 0, 1)
        self._ends[chunk] = float(path[-1])
        for old in [known for known in self._ends if known < chunk - KEPT]:
            del self._ends[old]
        return path
