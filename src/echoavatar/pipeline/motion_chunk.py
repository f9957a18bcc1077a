"""What leaves the pipeline for one session: eight frames of motion and face."""

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
