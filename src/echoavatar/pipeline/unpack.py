"""Decoded features to rotations, eight frames of a joint side by side, and back to what a session gets: frames."""

import numpy as np
from jaxtyping import Float

from ..kinematics import Skeleton
from ..kinematics.features import travel_slice
from ..kinematics.octets import from_two_rows
from ..nn.compiled import HALF, ONE, ZERO, F
from ..nn.octet import LANES, exact, is_any, load, size, spread, store, where
from .pose import Array, PoseLanes

_LARGEST = F(3e38)


class Unpacking:
    """The places of a rig's rotations and travel in a frame of features."""

    def __init__(self, skeleton: Skeleton) -> None:
        travel = travel_slice(skeleton)
        self.joints = np.array(skeleton.feature_joints, np.int64)
        first = 6 * np.arange(len(self.joints))  # channel of each joint's 6D
        self.first = np.where(first >= travel.start, first + travel.stop - travel.start, first).astype(
            np.int64
        )
        self.travel, self._all = travel.start, skeleton.joints

    def pose_of(self, features: Float[Array, "b t c"], fps: float) -> tuple[PoseLanes, bool]:
        """Rotations, and travel as decoded; and whether all of it can be used. At most 8 frames."""
        rows, frames = features.shape[:2]
        turns, root = (
            np.empty((rows, self._all, 4, LANES), np.float32),
            np.empty((rows, 3, LANES), np.float32),
        )
        if len(self.joints) < self._all:
            turns[...], turns[:, :, 0] = 0, 1
        is_good = unpack(np.ascontiguousarray(features), self.first, self.joints, self.travel, turns, root)
        return PoseLanes(turns, root, fps, frames), is_good


def frames_of(pose: PoseLanes) -> tuple[Float[Array, "b t j 4"], Float[Array, "b t 3"]]:
    """Rotations, quaternions with w >= 0, and root of each frame."""
    rows, joints = pose.turns.shape[:2]
    rotations = np.empty((rows, pose.frames, joints, 4), np.float32)
    root = np.empty((rows, pose.frames, 3), np.float32)
    pack(pose.turns, pose.root, rotations, root)
    return rotations, root


@exact()
def unpack(features, first, joints, travel, turns, root):  # type: ignore[no-untyped-def]
    """All rows; whether every number is finite and every rotation is one."""
    rows, frames, channels = features.shape
    columns = np.empty((channels, 8), F)
    is_good, zero, one = True, spread(ZERO), spread(ONE)
    for row in range(rows):
        for channel in range(channels):
            for frame in range(8):
                columns[channel, frame] = features[row, min(frame, frames - 1), channel]
        for index in range(joints.shape[0]):
            at = first[index]
            x = load(columns, (at,)), load(columns, (at + 1,)), load(columns, (at + 2,))
            y = load(columns, (at + 3,)), load(columns, (at + 4,)), load(columns, (at + 5,))
            turn = from_two_rows(x, y)
            for k, number in enumerate(turn):
                store(turns, (row, joints[index], k), number)
            length = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2] + turn[3] * turn[3]
            is_good &= not is_any(where(length > HALF, zero, one) > zero)
        for at in range(3):  # across, along, height
            number = load(columns, (travel + at,))
            store(root, (row, (3 - at) % 3), number)
            is_good &= not is_any(where(size(number) < _LARGEST, zero, one) > zero)
    return is_good


@exact()
def pack(turns, root, rotations, places):  # type: ignore[no-untyped-def]
    """Frame by frame, with w >= 0."""
    for row in range(rotations.shape[0]):
        for joint in range(turns.shape[1]):
            for frame in range(rotations.shape[1]):
                sign = -ONE if turns[row, joint, 0, frame] < ZERO else ONE
                for k in range(4):
                    rotations[row, frame, joint, k] = turns[row, joint, k, frame] * sign
        for frame in range(rotations.shape[1]):
            for axis in range(3):
                places[row, frame, axis] = root[row, axis, frame]
