"""The rounded parts of a body as tables, in the frames of a set of chains."""

import numpy as np
from jaxtyping import Float, Int

from ..kinematics import Skeleton
from ..kinematics.rigs import bone_map
from .chains import Chains
from .profile import BodyProfile, RoundedPart

Array = np.ndarray


class Body:
    """The parts of a profile that a rig has a bone for."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile) -> None:
        bones = bone_map(skeleton)
        self.parts: list[RoundedPart] = [part for part in profile.parts if part.bone in bones]
        self.joints = [bones[part.bone] for part in self.parts]
        self.centres = np.array(
            [part.centre for part in self.parts], np.float32
        ).T  # (3, e), in the bone's frame
        self.radii = np.array([part.radii for part in self.parts], np.float32).T

    def slots(self, chains: Chains) -> Int[Array, " e"]:
        """Where the carrying bones stand among the chains' joints."""
        return np.array([chains.slot[joint] for joint in self.joints])


def unit_axes(
    bones: Float[Array, "3 4 e n"], centres: Float[Array, "3 e"], radii: Float[Array, "3 e"]
) -> tuple[Float[Array, "3 3 e n"], Float[Array, "3 e n"]]:
    """The map into each part's own axes, in which it is a unit ball, and where that ball's middle then is."""
    axes = bones[:, :3].transpose(1, 0, 2, 3) * (1 / radii)[:, None, :, None]
    middles = np.add.reduce(axes * bones[:, 3], axis=1)
    middles += (centres / radii)[..., None]
    return axes, middles


def to_unit(
    bones: Float[Array, "3 4 e n"],
    centres: Float[Array, "3 e"],
    radii: Float[Array, "3 e"],
    points: Float[Array, "3 p n"],
) -> Float[Array, "3 e p n"]:
    """Points in each part's own axes, in which it is the unit ball."""
    axes, middles = unit_axes(bones, centres, radii)
    seen: Array = np.einsum("ijen,jpn->iepn", axes, points)
    seen -= middles[:, :, None]
    return seen
