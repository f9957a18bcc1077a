"""The paper's own rule (Online Post-Processing): a cylinder around the spine, a remap of distance, a shoulder swing.

It serves bundles whose rig was tuned with it, and comparisons. `HandCollisions` is the default, and its module lists
the differences. This rule acts on whole arrays.

Let d be a wrist's horizontal distance from the pelvis' vertical axis, r the cylinder's radius at its height, and s the
smoothstep. The wrist's target is at distance d + r (1 - s(d / (1.5 r))): 0 goes to r, 1.5 r stays. The arm then rotates
about the shoulder by the least rotation that points it at the target. The hand gets the target's direction, but not
its distance.

`swing_clear` is the rule. The paper shapes the cylinder by hand "based on the model width". `Cylinder` makes one for a
character that has none: its radius at a height is the half width of the body's part there (`BodyProfile`), plus half
the thickness of a palm.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from pydantic import Field

from echoavatar.config import Config

from ..kinematics import Skeleton, forward_kinematics
from ..kinematics.joint_tree import SIDES
from ..kinematics.rigs import bone_map
from ..kinematics.rotations import least_rotation, length, matrix_from_quaternion, quaternion_from_matrix, unit
from .profile import BodyProfile, body_of_rig


class SwingConfig(Config):
    """A cylinder whose radius changes with height, in the unit of the rig."""

    profile: tuple[tuple[float, float], ...] = Field(
        min_length=2, description="(height above the pelvis, radius), from below; flat beyond the ends"
    )
    reach: float = Field(1.5, gt=1, description="radii at which the rule begins to act")
    up: int = Field(1, ge=0, le=2, description="axis of the pelvis that points up: 0 x, 1 y, 2 z")
    snap: float = Field(0.0, ge=0, description="1 - cosine below which a swing is left out (reference: 1e-6)")


def remapped_distance(
    distance: Float[np.ndarray, "*n"], radius: Float[np.ndarray, "*n"], reach: float = 1.5
) -> Float[np.ndarray, "*n"]:
    """Distance from the axis after the rule: distances up to `reach` radii become one to `reach` radii, others stay."""
    share = np.clip(distance / (reach * radius), 0, 1)
    further: np.ndarray = distance + radius * (1 - share**2 * (3 - 2 * share))
    return further


def radius_at(height: Float[np.ndarray, "*n"], config: SwingConfig) -> Float[np.ndarray, "*n"]:
    """Radius of the cylinder, linear between the profile's points."""
    radius = np.full_like(height, config.profile[0][1])
    for (low, first), (high, second) in pairwise(config.profile):
        radius = radius + (second - first) * np.clip((height - low) / (high - low), 0, 1)
    return radius


def swing_between(
    start: Float[np.ndarray, "*n 3"], end: Float[np.ndarray, "*n 3"], snap: float = 0.0
) -> Float[np.ndarray, "*n 3 3"]:
    """`least_rotation`, left out where 1 - cosine of its angle is below `snap`."""
    rotation = least_rotation(start, end)
    cosine = (unit(start) * unit(end)).sum(-1)[..., None, None]
    return np.where(cosine > 1 - snap, np.eye(3, dtype=rotation.dtype), rotation) if snap else rotation


def swing_clear(
    skeleton: Skeleton, rotations: Float[np.ndarray, "*n j 3 3"], config: SwingConfig, arms: tuple[tuple[int, int], ...]
) -> Float[np.ndarray, "*n j 3 3"]:
    """Parent-relative rotations with each arm swung clear; `arms` are (upper arm joint, wrist joint) pairs.

    A wrist exactly on the axis has no half-plane and stays where it is.
    """
    upright, changed = rotations.copy(), rotations.copy()
    upright[..., 0, :, :] = np.eye(3)
    pose = forward_kinematics(skeleton, upright, np.zeros_like(rotations[..., 0, :, 0]))
    for shoulder, wrist in arms:
        hand = pose.positions[..., wrist, :]
        flat = hand * (np.arange(3) != config.up)
        distance = length(flat)[..., 0]
        radius = radius_at(hand[..., config.up], config)
        further = remapped_distance(distance, radius, config.reach) / (distance + 1e-9)
        target = hand + flat * (further - 1)[..., None]
        origin = pose.positions[..., shoulder, :]
        swing = swing_between(hand - origin, target - origin, config.snap)
        above = pose.rotations[..., skeleton.parents[shoulder], :, :]
        new = above.mT @ swing @ pose.rotations[..., shoulder, :, :]
        is_near = (distance < config.reach * radius)[..., None, None]
        changed[..., shoulder, :, :] = np.where(is_near, new, rotations[..., shoulder, :, :])
    return changed


class Cylinder:
    """Keeps both hands outside a cylinder around the spine."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile | None = None) -> None:
        """Raises MotionError when the rig's bones are not known."""
        bones, body = bone_map(skeleton), profile or body_of_rig(skeleton)
        rest, self._skeleton = skeleton.rest_positions, skeleton
        hips = float(rest[bones["hips"], 1])
        widths = {
            round(float(rest[bones[part.bone], 1]) + part.centre[1] - hips, 4): part.radii[0] + body.palm
            for part in body.parts
            if part.bone in bones
        }
        self.config = SwingConfig.model_validate({"profile": sorted(widths.items())})
        self._arms = tuple((bones[f"{side}UpperArm"], bones[f"{side}Hand"]) for side in SIDES)

    def resolve(self, rotations: Float[np.ndarray, "b t j 4"]) -> Float[np.ndarray, "b t j 4"]:
        """The same parent-relative quaternions with both upper arms swung clear."""
        matrices = matrix_from_quaternion(rotations)
        clear = swing_clear(self._skeleton, matrices, self.config, self._arms)
        changed = rotations.copy()
        for shoulder, _ in self._arms:
            changed[..., shoulder, :] = quaternion_from_matrix(clear[..., shoulder, :, :])
        return changed
