"""What leaves the pipeline for one session: a chunk of motion and face."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class MotionChunk(NamedTuple):
    """Parent-relative rotations, root positions and face of consecutive frames at 30 fps."""

    rotations: Float[np.ndarray, "t j 4"]  # quaternions wxyz
    root: Float[np.ndarray, "t 3"]  # metres
    face: Float[np.ndarray, "t 52"] | None = (
        None  # ARKit curves 0..1 (`face.ARKIT_NAMES`); None without a model
    )


def join(chunks: Sequence[MotionChunk]) -> MotionChunk:
    """Consecutive chunks in one piece; without a face unless all have one."""
    rotations, root = (np.concatenate([chunk[part] for chunk in chunks]) for part in (0, 1))
    faces = [chunk.face for chunk in chunks if chunk.face is not None]
    return MotionChunk(rotations, root, np.concatenate(faces) if len(faces) == len(chunks) else None)
