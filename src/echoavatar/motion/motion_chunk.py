"""A chunk of motion and face for one session, and a batch of chunks for many."""

from collections.abc import Sequence
from itertools import repeat
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


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
