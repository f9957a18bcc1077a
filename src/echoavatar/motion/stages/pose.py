"""The data that the stages behind the decoder pass on: a chunk of several sessions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray


@dataclass
class Pose:
    """Consecutive frames of several sessions. Stages change them in place, one after the other."""

    rotations: Float[Array, "b t j 4"]  # parent-relative unit quaternions `wxyz`, of either sign
    root: Float[Array, "b t 3"]  # metres; before `Ground`: metres per frame along x, height, metres per frame along z
    fps: float

    @property
    def frames(self) -> int:
        """How many frames the chunk has."""
        return int(self.root.shape[1])
