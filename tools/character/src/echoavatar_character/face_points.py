"""Points of a face and their places on it, in which expressions are written.

Everything is defined for the left side (+X); the right side is its mirror image. Metres, neutral face.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .figure_mouth import ARCH, WIDE, line
from .sdf import Distances, Points, rise

Moves = Float[np.ndarray, "n 3"]
Shares = Float[np.ndarray, " n"]


class FacePoints(NamedTuple):
    """Points of one part of the neutral face.

    Parts are: skin, brows, lashes, left eye, right eye, upper teeth, lower teeth, tongue.
    """

    part: str
    at: Points
    above: Shares  # +1 upper lip and all above it, -1 lower lip and all below (`figure_mouth.above`)

    @property
    def height(self) -> Distances:
        """Height above the line between the lips."""
        height: Distances = self.at[:, 1] - line(self.at[:, 0])
        return height

    @property
    def beyond(self) -> Distances:
        """Distance outside the corners of the mouth; 0 between them."""
        beyond: Distances = np.maximum(np.abs(self.at[:, 0]) - WIDE, 0)
        return beyond

    @property
    def front(self) -> Shares:
        """1 on face and lips, 0 in the depth of the mouth and at the back of the head."""
        return rise(self.at[:, 2] + ARCH * np.minimum(np.abs(self.at[:, 0]), 0.05) ** 2, 0.055, 0.078)

    def mirrored(self) -> "FacePoints":
        """The same points on the other side."""
        swap = {"left eye": "right eye", "right eye": "left eye"}
        return FacePoints(swap.get(self.part, self.part), self.at * [-1, 1, 1], self.above)


def bell(x: Distances, reach: float) -> Shares:
    """1 at 0, 0.37 at `reach`, soon 0."""
    share: Shares = np.exp(-((x / reach) ** 2))
    return share


def around(at: Points, centre: tuple[float, float, float], reach: tuple[float, float, float]) -> Shares:
    """1 at `centre`, falling off over `reach` along x, y and z."""
    share: Shares = np.exp(-(((at - np.asarray(centre)) / np.asarray(reach)) ** 2).sum(1))
    return share


def moves(x: Distances | float = 0.0, y: Distances | float = 0.0, z: Distances | float = 0.0) -> Moves:
    """Displacements from their components, at least one of which is an array."""
    return np.stack(np.broadcast_arrays(x, y, z), axis=1).astype(np.float64)


def total(*parts: Moves) -> Moves:
    """The sum of displacements."""
    whole: Moves = np.sum(parts, axis=0)
    return whole
