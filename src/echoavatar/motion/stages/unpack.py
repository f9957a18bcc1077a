"""Unpack decoded features into rotations and root travel."""

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernels import kernel

from ..kinematics import Skeleton
from ..kinematics.features import travel_slice
from ..kinematics.quaternions import from_two_rows, read_vector, write_quaternion
from .pose import Array, Pose


class Unpacking:
    """Where a rig's rotations and travel lie in a frame of features."""

    def __init__(self, skeleton: Skeleton) -> None:
        travel = travel_slice(skeleton)
        first = 6 * np.arange(len(skeleton.feature_joints))  # channel of each joint's 6D
        first[first >= travel.start] += travel.stop - travel.start
        self._first, self._feature_joints = first, np.array(skeleton.feature_joints, np.int64)
        self._travel, self._joints = travel.start, skeleton.joints

    def pose_of(self, features: Float[Array, "b t c"], fps: float) -> tuple[Pose, bool]:
        """Rotations, and travel as decoded; and whether all of them are valid."""
        rows, frames = features.shape[:2]
        rotations = np.zeros((rows, frames, self._joints, 4), np.float32)
        rotations[..., 0] = 1  # joints without features rest
        root = np.empty((rows, frames, 3), np.float32)
        given = np.ascontiguousarray(features)
        is_good = unpack(given, self._first, self._feature_joints, self._travel, rotations, root)
        return Pose(rotations, root, fps), is_good


@kernel()
def unpack(features, first, joints, travel, rotations, root):  # type: ignore[no-untyped-def]
    """Fill `rotations` and `root`; returns whether every number is finite and every rotation valid."""
    is_good = True
    for row in range(features.shape[0]):
        for frame in range(features.shape[1]):
            numbers = features[row, frame]
            for index in range(len(joints)):
                at = first[index]
                q = from_two_rows(read_vector(numbers[at:]), read_vector(numbers[at + 3 :]))
                is_good &= q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] > 0.5
                write_quaternion(rotations[row, frame, joints[index]], q)
            for axis, at in enumerate((travel, travel + 2, travel + 1)):  # decoded as across, along, height
                root[row, frame, axis] = numbers[at]
                is_good &= np.isfinite(numbers[at])
    return is_good
