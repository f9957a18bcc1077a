"""Decoded features to rotations, eight frames of a joint side by side, and back to what a session gets: frames."""

import numpy as np
from jaxtyping import Float

from ..errors import MotionError
from ..kinematics import Skeleton
from ..kinematics.features import travel_slice
from ..kinematics.octets import from_two_rows
from ..nn.compiled import HALF, ONE, ZERO, F
from ..nn.octet import (
    LANES,
    ask_for,
    exact,
    fused,
    inner,
    is_any,
    load,
    scratch,
    size,
    spread,
    store,
    transposed,
    where,
)
from .pose import Array, PoseLanes

_LARGEST = F(3e38)
_ROWS_AHEAD = 6  # whose features are asked for meanwhile; they have not been near a cache for long
_LINE = 16  # numbers that come at a time


class Unpacking:
    """The places of a rig's rotations and travel in a frame of features."""

    def __init__(self, skeleton: Skeleton) -> None:
        """
        Raises:
            MotionError: a rig of one joint, or one of which no joint is in a part: loops take eight numbers at once.
        """
        if skeleton.joints < 2 or not skeleton.feature_joints:
            moving = f"{skeleton.joints} joints, {len(skeleton.feature_joints)} of them in a part"
            raise MotionError(
                f"a body needs two joints and one that moves, got {moving}; add bones to its parts"
            )
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
    columns = scratch((features.shape[2], 8))
    is_good = True
    row_ahead = _ROWS_AHEAD * features.shape[1] * features.shape[2]
    for row in range(features.shape[0]):
        _turn_over(features, row, columns)
        for index in range(joints.shape[0]):
            for line in range(3):  # its share: 6 numbers in 8 frames
                ask_for(features, (row,), row_ahead + (3 * index + line) * _LINE)
            at = first[index]
            x = load(columns, (at,)), load(columns, (at + 1,)), load(columns, (at + 2,))
            y = load(columns, (at + 3,)), load(columns, (at + 4,)), load(columns, (at + 5,))
            turn = from_two_rows(x, y)
            for k, number in enumerate(turn):
                store(turns, (row, joints[index], k), number)
            w, x, y, z = turn
            length = fused(w, w, fused(x, x, fused(y, y, z * z)))
            is_good &= not is_any(where(length > HALF, spread(ZERO, length), ONE) > ZERO)
        for at in range(3):  # across, along, height
            number = load(columns, (travel + at,))
            store(root, (row, (3 - at) % 3), number)
            is_good &= not is_any(where(size(number) < _LARGEST, spread(ZERO, number), ONE) > ZERO)
    return is_good


@inner()
def _turn_over(features, row, columns):  # type: ignore[no-untyped-def]
    """The frames of each channel side by side; the last one again where there are fewer than eight."""
    last = features.shape[1] - 1
    for block in range(0, features.shape[2], 8):
        at = max(min(block, features.shape[2] - 8), 0)  # the last eight meet some again
        eight = (
            load(features, (row, 0, at)),
            load(features, (row, min(1, last), at)),
            load(features, (row, min(2, last), at)),
            load(features, (row, min(3, last), at)),
            load(features, (row, min(4, last), at)),
            load(features, (row, min(5, last), at)),
            load(features, (row, min(6, last), at)),
            load(features, (row, min(7, last), at)),
        )
        for channel, number in enumerate(transposed(eight)):
            store(columns, (at + channel,), number)


@exact()
def pack(turns, root, rotations, places):  # type: ignore[no-untyped-def]
    """Frame by frame, with w >= 0."""
    joints, count = turns.shape[1], rotations.shape[1]
    for row in range(rotations.shape[0]):
        for two in range(0, joints, 2):
            a = min(two, joints - 2)  # a last one without partner comes with the one before it
            b = a + 1
            one, other = load(turns, (row, a, 0)), load(turns, (row, b, 0))
            one, other = (
                where(one < ZERO, -ONE, spread(ONE, one)),
                where(other < ZERO, -ONE, spread(ONE, other)),
            )
            eight = (
                load(turns, (row, a, 0)) * one,
                load(turns, (row, a, 1)) * one,
                load(turns, (row, a, 2)) * one,
                load(turns, (row, a, 3)) * one,
                load(turns, (row, b, 0)) * other,
                load(turns, (row, b, 1)) * other,
                load(turns, (row, b, 2)) * other,
                load(turns, (row, b, 3)) * other,
            )
            for frame, numbers in enumerate(transposed(eight)):
                if frame < count:
                    store(rotations, (row, frame, a, 0), numbers)
        for frame in range(count):
            for axis in range(3):
                places[row, frame, axis] = root[row, axis, frame]
