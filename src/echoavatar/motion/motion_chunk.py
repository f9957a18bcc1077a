"""A chunk of motion and face for one session, a batch of chunks for many, and a fade across chunks."""

from collections.abc import Sequence
from itertools import repeat
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize


class MotionChunk(NamedTuple):
    """Parent-relative rotations, root positions and face of consecutive frames at 30 fps."""

    rotations: Float[np.ndarray, "t j 4"]  # quaternions wxyz
    root: Float[np.ndarray, "t 3"]  # metres
    face: Float[np.ndarray, "t 52"] | None = None  # ARKit curves 0..1 (`arkit.ARKIT_NAMES`); None without a face model

    def part(self, start: int, stop: int | None = None) -> "MotionChunk":
        """Some of the frames."""
        face = None if self.face is None else self.face[start:stop]
        return MotionChunk(self.rotations[start:stop], self.root[start:stop], face)


def join(chunks: Sequence[MotionChunk]) -> MotionChunk:
    """Consecutive chunks as one; without a face unless all have one."""
    rotations, root = (np.concatenate([chunk[part] for chunk in chunks]) for part in (0, 1))
    faces = [chunk.face for chunk in chunks if chunk.face is not None]
    return MotionChunk(rotations, root, np.concatenate(faces) if len(faces) == len(chunks) else None)


class MotionBatch(NamedTuple):
    """The same frames of many sessions, without faces, as it passes from stage to stage."""

    rotations: Float[np.ndarray, "b t j 4"]
    root: Float[np.ndarray, "b t 3"]

    def split(self, faces: Float[np.ndarray, "b t 52"] | None) -> list[MotionChunk]:
        """The chunk of each session; its arrays are views."""
        each = zip(self.rotations, self.root, repeat(None) if faces is None else faces, strict=False)
        return [MotionChunk(*one) for one in each]


def join_batches(batches: Sequence[MotionBatch]) -> MotionBatch:
    """Consecutive batches of the same sessions as one."""
    if len(batches) == 1:
        return batches[0]
    return MotionBatch(*(np.concatenate([batch[part] for batch in batches], 1) for part in (0, 1)))


KEPT = 128  # chunks whose last value is remembered: further than a session can go back


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
        self._ends.pop(chunk - KEPT, None)
        return path
