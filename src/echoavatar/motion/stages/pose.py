"""The chunk that the stages pass on: decoded features unpacked into rotations and root travel, and repaired.

An invalid rotation (NaN, infinity, rows from which no rotation can be made) is replaced by the joint's previous one in
the chunk, else by the one shown last, else by rest. An invalid root does not travel and keeps its height. The length of
rotations does not matter: features are made orthonormal and quaternions are normalised.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernels import kernel

from ..kinematics import Skeleton
from ..kinematics.features import travel_slice
from ..kinematics.quaternions import from_two_rows, read_vector, write_quaternion

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


class Unpacking:
    """Where a rig's rotations and travel lie in a frame of features."""

    def __init__(self, skeleton: Skeleton) -> None:
        travel = travel_slice(skeleton)
        first = 6 * np.arange(len(skeleton.feature_joints))  # channel of each joint's 6D
        first[first >= travel.start] += travel.stop - travel.start
        self._first, self._feature_joints = first, np.array(skeleton.feature_joints, np.int64)
        self._travel, self._joints = travel.start, skeleton.joints

    def pose_of(self, features: Float[Array, "b t c"], fps: float) -> tuple[Pose, bool]:
        """The rotations and the decoded travel, and whether all of them are valid."""
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
            for axis, at in enumerate((travel, travel + 2, travel + 1)):  # features hold x, z, height
                root[row, frame, axis] = numbers[at]
                is_good &= np.isfinite(numbers[at])
    return is_good


def repair(pose: Pose, last: Float[Array, "b j 4"], standing: float) -> int:
    """Repair `pose` in place and return how many rotations and root positions were invalid.

    `pose.root` is still travel here. `last` holds the rotations shown last, zero where there are none. `standing` is
    the height, in metres, of a root that never had a valid one.
    """
    rotations, root = pose.rotations, pose.root
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.square(rotations).sum(-1)
    bad = ~(size > 0.5) | ~np.isfinite(size)
    for row, frame, joint in np.argwhere(bad):
        before = rotations[row, frame - 1, joint] if frame else last[row, joint]
        rotations[row, frame, joint] = before if before.any() else (1, 0, 0, 0)
    lost = ~np.isfinite(root).all(-1)
    for row, frame in np.argwhere(lost):
        root[row, frame] = 0, root[row, frame - 1, 1] if frame else standing, 0
    return int(bad.sum() + lost.sum())
