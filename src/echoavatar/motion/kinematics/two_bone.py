"""Two-bone IK in closed form, for whole clips; `ik.limbs` has the compiled loops of the stages."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .motion import Pose
from .rotations import least_rotation, length, matrix_from_axis_angle
from .skeleton import Skeleton

REACH = 0.9995  # greatest distance to the target, as a share of the stretched length


class Limb(NamedTuple):
    """The joints of a leg or an arm: of its upper and lower bone and its foot or hand, and their parents."""

    joints: tuple[int, int, int]
    parents: tuple[int, int, int]  # a rig may have extra joints in a limb

    @classmethod
    def of(cls, skeleton: Skeleton, joints: tuple[int, int, int]) -> "Limb":
        """The limb of these joints."""
        a, b, c = joints
        return cls(joints, (skeleton.parents[a], skeleton.parents[b], skeleton.parents[c]))


def bend_limb(
    limb: Limb,
    rotations: Float[np.ndarray, "t j 3 3"],
    pose: Pose,
    *,
    hinge: Float[np.ndarray, "t 3"],
    target: Float[np.ndarray, "t 3"],
    end: Float[np.ndarray, "t 3 3"],
) -> Float[np.ndarray, "t j 3 3"]:
    """Parent-relative rotations with the limb bent as by `reach`, and its foot or hand in the world rotation `end`."""
    hip, knee, ankle = limb.joints
    places, world = pose.positions, pose.rotations
    first, second = reach(hip=places[:, hip], knee=places[:, knee], ankle=places[:, ankle], hinge=hinge, target=target)
    over_hip, over_knee, over_ankle = (world[:, parent] for parent in limb.parents)
    bent = rotations.copy()
    bent[:, hip] = over_hip.mT @ (first @ world[:, hip])
    bent[:, knee] = (first @ over_knee).mT @ (second @ world[:, knee])
    bent[:, ankle] = (second @ over_ankle).mT @ end
    return bent


def reach(
    *,
    hip: Float[np.ndarray, "*n 3"],
    knee: Float[np.ndarray, "*n 3"],
    ankle: Float[np.ndarray, "*n 3"],
    hinge: Float[np.ndarray, "*n 3"],
    target: Float[np.ndarray, "*n 3"],
) -> tuple[Float[np.ndarray, "*n 3 3"], Float[np.ndarray, "*n 3 3"]]:
    """World rotations that bring the ankle to the target: multiply them onto those of the upper and the lower bone.

    The lower bone first rotates about `hinge` (a world unit axis; a positive angle flexes) until the distance fits.
    Then both rotate by the least rotation that points at the target. If the target is out of reach, the limb is
    stretched towards it.
    """
    upper, lower = knee - hip, ankle - knee
    a, b, far = (length(way)[..., 0] for way in (upper, lower, target - hip))
    distance = np.maximum(np.minimum(far, REACH * (a + b)), np.abs(a - b) + 1e-4)
    wanted = (distance**2 - a**2 - b**2) / 2  # upper . lower when the distance fits
    along = (lower * hinge).sum(-1, keepdims=True) * hinge
    across = lower - along
    constant = (upper * along).sum(-1)
    cosine = (upper * across).sum(-1)
    sine = (upper * np.cross(hinge, across)).sum(-1)
    size = np.maximum(np.hypot(cosine, sine), 1e-9)
    straight = np.arctan2(sine, cosine)  # the angle that stretches the limb
    bend = np.arccos(np.clip((wanted - constant) / size, -1, 1))
    angle = np.remainder(straight + bend + np.pi, 2 * np.pi) - np.pi  # on the flexed side
    fold = matrix_from_axis_angle(hinge * angle[..., None])
    reached = upper + (fold @ lower[..., None])[..., 0]
    point = least_rotation(reached, target - hip)
    return point, point @ fold
