"""Motion features: the tokenizer's input for each frame (paper, Motion Tokenizer and Settings).

A frame lists the parts in the skeleton's order (lower body, upper body, hands). Each part lists the 6D rotations of its
joints in ascending order. The first part ends with three travel values: the root's horizontal velocity (metres per
frame along the world's axes, frame t minus t-1, zero on the first frame) and its height.

Our height is absolute. In the paper's released data Z is up, lengths are in centimetres, and the height starts from the
rest pose's in the first frame of each clip.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .rotations import matrix_from_6d, matrix_to_6d
from .skeleton import Skeleton

TRAVEL_SIZE = 3


def ground_axes(up: int) -> list[int]:
    """The two horizontal axes, ascending; `up` is the vertical one: 0, 1, 2 for x, y, z."""
    return [axis for axis in range(3) if axis != up]


class MotionFrames(NamedTuple):
    """Parent-relative rotation matrices and the root's world position."""

    rotations: Float[np.ndarray, "*n t j 3 3"]
    root: Float[np.ndarray, "*n t 3"]


def part_sizes(skeleton: Skeleton) -> dict[str, int]:
    """Feature channels of each part, in order: 57, 78 and 180 for our rig. Raises ValueError: it has no parts."""
    sizes = {name: 6 * len(joints) for name, joints in skeleton.config.parts.items()}
    if not sizes:
        raise ValueError("the skeleton names no body parts, so it has no motion features")
    sizes[next(iter(sizes))] += TRAVEL_SIZE
    return sizes


def travel_slice(skeleton: Skeleton) -> slice:
    """The channels of velocity and height, in the whole vector and in the first part alike."""
    end = next(iter(part_sizes(skeleton).values()))
    return slice(end - TRAVEL_SIZE, end)


def to_features(
    skeleton: Skeleton,
    rotations: Float[np.ndarray, "*n t j 3 3"],
    root: Float[np.ndarray, "*n t 3"],
    *,
    previous_ground: Float[np.ndarray, "*n 2"] | None = None,
    up: int = 1,
) -> Float[np.ndarray, "*n t c"]:
    """Features of a clip.

    Args:
        skeleton: a rig with body parts.
        rotations: parent-relative rotation matrices.
        root: world position of the root, in the unit of the skeleton.
        previous_ground: horizontal position of the frame before the first, for a clip that continues another (so
            pieces have the features of the whole); None for a clip that starts here.
        up: the vertical axis: 0, 1, 2 for x, y, z.
    """
    ground = root[..., ground_axes(up)]
    before = ground[..., :1, :] if previous_ground is None else previous_ground[..., None, :]
    velocity = ground - np.concatenate([before, ground[..., :-1, :]], -2)
    height = root[..., up, None]
    six = matrix_to_6d(rotations[..., list(skeleton.feature_joints), :, :]).reshape(*root.shape[:-1], -1)
    start = travel_slice(skeleton).start
    return np.concatenate([six[..., :start], velocity, height, six[..., start:]], -1)


def from_features(skeleton: Skeleton, features: Float[np.ndarray, "*n t c"], *, up: int = 1) -> MotionFrames:
    """Rotations and root from features; joints outside all parts stay at rest.

    The root starts over the origin; `up` is the vertical axis: 0, 1, 2 for x, y, z.
    """
    travel = travel_slice(skeleton)
    joints = list(skeleton.feature_joints)
    six = np.concatenate([features[..., : travel.start], features[..., travel.stop :]], -1)
    matrices = matrix_from_6d(six.reshape(*six.shape[:-1], len(joints), 6))
    rotations = np.tile(np.eye(3, dtype=features.dtype), (*features.shape[:-1], skeleton.joints, 1, 1))
    rotations[..., joints, :, :] = matrices
    ground, height = features[..., travel][..., :2].cumsum(-2), features[..., travel][..., 2]
    return MotionFrames(rotations, np.insert(ground, up, height, -1))
