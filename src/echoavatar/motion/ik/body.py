"""A body profile as arrays, for the bones of one rig."""

import numpy as np
from jaxtyping import Float

from ..kinematics import Skeleton
from ..kinematics.rigs import bone_map
from .profile import BodyProfile, RoundedPart

Array = np.ndarray


class Body:
    """The parts of a profile whose bones the rig has."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile) -> None:
        bones = bone_map(skeleton)
        self.parts: list[RoundedPart] = [part for part in profile.parts if part.bone in bones]
        self.joints = [bones[part.bone] for part in self.parts]
        self.centres = np.array([part.centre for part in self.parts], np.float32)  # (e, 3), in the bone's frame
        self.radii = np.array([part.radii for part in self.parts], np.float32)

    def to_unit(
        self, rotations: Float[Array, "t e 3 3"], places: Float[Array, "t e 3"], points: Float[Array, "t p 3"]
    ) -> Float[Array, "t e p 3"]:
        """Points in each part's own axes, in which the part is the unit ball.

        `rotations` and `places` are those of the parts' bones.
        """
        away = points[:, None] - places[:, :, None]
        local = np.einsum("teij,tepi->tepj", rotations, away) - self.centres[:, None]
        unit: Array = local / self.radii[:, None]
        return unit
