"""What leaves the pipeline for one session: eight frames of motion."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class MotionChunk(NamedTuple):
    """Parent-relative rotations and root positions of consecutive frames at 30 fps."""

    rotations: Float[np.ndarray, "t j 4"]  # quaternions wxyz
    root: Float[np.ndarray, "t 3"]  # metres
