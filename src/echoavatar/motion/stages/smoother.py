"""A smoother that removes trembling and jumps, and bounds the speed of every joint.

Sampled codes carry noise that a decoder cannot tell from motion. Each motion token (4 frames) may begin with a jump,
and the first frames of a chunk need not continue the last ones. So the body is shown `DELAY` frames late, as late as
the face: the last frames before a jump are not shown yet, and can lead to it. They and the new chunk, x, are replaced
by a path y that continues the frames already shown and approaches the decoded rotations towards its end (a
Whittaker-Henderson smoother with a fixed start). y minimises

    sum_k  ((k + 1) / n)^LATE |y_k - x_k|^2  +  STIFFNESS s_k |third difference of (shown, y) that ends in y_k|^2

over the four numbers of the unit quaternions, and over the root's travel. The solution is one small matrix. All of y
but its last frames is shown. s_k is `BEND` where a motion token begins, and 1 elsewhere: there acceleration may change
at less cost. No joint turns faster than `FASTEST`. `docs/results/post.md` says how the numbers were chosen. Not in the
paper.

`SpeedLimit` holds the same bound behind the last stage. A hand that would pass through the body is pushed out of it,
and when the nearest way out changes sides, the hand would change sides within one frame. The limit spreads such a turn
over several frames.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN

from ..kinematics.quaternions import inner_product, normalized, read_quaternion, write_quaternion, write_vector
from .pose import Array, Pose

FASTEST = math.radians(1000)  # per second
LATE = 5  # exponent of the weight of later frames
STIFFNESS = 0.5  # at 0 the path is the decoded one
BEND = 0.5  # factor of the stiffness where a motion token begins
SHOWN = 3  # frames that a third difference reaches back
DELAY = 1  # frames by which the body is shown after its sound
KNOWN = SHOWN + DELAY


@dataclass
class SmootherState(StreamState):
    """The last `SHOWN` rotations and travels shown, then `DELAY` decoded ones not yet shown; zero before the first."""

    rotations: Float[Array, "b 4 j 4"]
    travel: Float[Array, "b 4 3"]


class Smoother:
    """Smooths joint rotations and root travel; before its first frame, a session counts as at rest in that frame."""

    def __init__(self, joints: int, stiffness: float = STIFFNESS) -> None:
        self._joints, self._stiffness = joints, stiffness

    def init_state(self, rows: int) -> SmootherState:
        """Nothing shown yet."""
        known = np.zeros((rows, KNOWN, self._joints, 4), np.float32)
        return SmootherState(known, np.zeros((rows, KNOWN, 3), np.float32))

    def step(self, pose: Pose, state: SmootherState, active: Bool[Array, " b"]) -> None:
        """Smooth the rotations and the travel of active rows, in place; they come `DELAY` frames later."""
        weights = shares(pose.frames, self._stiffness)
        cosine = math.cos(FASTEST / pose.fps / 2)
        smooth(pose.rotations, pose.root, state.rotations, state.travel, active, weights, cosine)


@cache
def shares(frames: int, stiffness: float) -> Float[Array, "t n"]:
    """The solution of the minimum: the weight of each frame, shown or decoded (n = 4 + t), in each smoothed one."""
    count = DELAY + frames
    third = np.diff(np.eye(SHOWN + count), n=3, axis=0)
    past, own = third[:, :SHOWN], third[:, SHOWN:]
    place = np.arange(count)
    weight = np.diag(((place + 1) / count) ** LATE)
    stiff = stiffness * np.where((place - DELAY) % FRAMES_PER_MOTION_TOKEN == 0, BEND, 1.0)[:, None]
    right = np.concatenate([-own.T @ (stiff * past), weight], 1)
    return np.ascontiguousarray(np.linalg.solve(weight + own.T @ (stiff * own), right)[:frames])


@kernel()
def weighted_sum(shares, path):  # type: ignore[no-untyped-def]
    """The weighted sum of the frames of a path (n, 4)."""
    a = b = c = d = 0.0
    for frame in range(len(shares)):
        a += shares[frame] * path[frame, 0]
        b += shares[frame] * path[frame, 1]
        c += shares[frame] * path[frame, 2]
        d += shares[frame] * path[frame, 3]
    return a, b, c, d


@kernel()
def slowed_down(before, after, cosine):  # type: ignore[no-untyped-def]
    """`after`, or the rotation on the way to it whose half angle from `before` has this cosine."""
    along = inner_product(before, after)
    side = -1.0 if along < 0.0 else 1.0
    w, x, y, z = after[0] * side, after[1] * side, after[2] * side, after[3] * side
    along = abs(along)
    if along >= cosine:
        return w, x, y, z
    aside = normalized((w - before[0] * along, x - before[1] * along, y - before[2] * along, z - before[3] * along))
    sine = math.sqrt(1.0 - cosine * cosine)
    return normalized(
        (
            before[0] * cosine + aside[0] * sine,
            before[1] * cosine + aside[1] * sine,
            before[2] * cosine + aside[2] * sine,
            before[3] * cosine + aside[3] * sine,
        )
    )


@kernel()
def join(path, past, now, is_new):  # type: ignore[no-untyped-def]
    """Fill `path` with the frames known and those of the chunk; a new session repeats its first frame."""
    for number in range(now.shape[1]):
        for frame in range(KNOWN):
            path[frame, number] = now[0, number] if is_new else past[frame, number]
        for frame in range(len(now)):
            path[KNOWN + frame, number] = now[frame, number]


@kernel()
def align_signs(path):  # type: ignore[no-untyped-def]
    """Choose the signs of a path of quaternions so that each is in the hemisphere of the one before it."""
    for frame in range(1, len(path)):
        if inner_product(path[frame - 1], path[frame]) < 0.0:
            path[frame] *= -1.0


@kernel()
def remember(past, path, now):  # type: ignore[no-untyped-def]
    """Fill `past` for the next chunk: the last `SHOWN` frames shown, then the last `DELAY` frames decoded."""
    for number in range(now.shape[1]):
        for frame in range(SHOWN):
            then = len(now) + frame
            past[frame, number] = path[then, number] if then < SHOWN else now[then - SHOWN, number]
        for frame in range(SHOWN, KNOWN):
            past[frame, number] = path[len(now) + frame, number]


@kernel()
def smooth(rotations, root, shown, travel, active, shares, cosine):  # type: ignore[no-untyped-def]
    """Smooth active rows, joint by joint; `cosine` is that of half the angle that a joint may turn in a frame."""
    frames = rotations.shape[1]
    path = np.zeros((KNOWN + frames, 4))
    for row in range(len(rotations)):
        if not active[row]:
            continue
        is_new = not shown[row, SHOWN - 1, 0].any()
        for joint in range(rotations.shape[2]):
            past, now = shown[row, :, joint], rotations[row, :, joint]
            join(path, past, now, is_new)
            align_signs(path)
            last = read_quaternion(path[SHOWN - 1])
            for frame in range(frames):
                last = slowed_down(last, normalized(weighted_sum(shares[frame], path)), cosine)
                write_quaternion(now[frame], last)
            remember(past, path, now)
        join(path, travel[row], root[row], is_new)
        for frame in range(frames):
            write_vector(root[row, frame], weighted_sum(shares[frame], path))
        remember(travel[row], path, root[row])


@dataclass
class SpeedLimitState(StreamState):
    """The last rotations shown; zero where nothing was shown yet."""

    rotations: Float[Array, "b j 4"]


class SpeedLimit:
    """Holds back joints that turn faster than `FASTEST`."""

    def __init__(self, joints: int) -> None:
        self._joints = joints

    def init_state(self, rows: int) -> SpeedLimitState:
        """Nothing shown yet."""
        return SpeedLimitState(np.zeros((rows, self._joints, 4), np.float32))

    def step(self, pose: Pose, state: SpeedLimitState, active: Bool[Array, " b"]) -> None:
        """Hold back the rotations of active rows, in place."""
        hold_back(pose.rotations, state.rotations, active, math.cos(FASTEST / pose.fps / 2))


@kernel()
def hold_back(rotations, shown, active, cosine):  # type: ignore[no-untyped-def]
    """Turn every joint of active rows towards its rotation in each frame, by an angle of at most twice acos(cosine)."""
    for row in range(len(rotations)):
        if not active[row]:
            continue
        is_new = not shown[row, 0].any()
        for joint in range(rotations.shape[2]):
            now = rotations[row, :, joint]
            last = read_quaternion(now[0] if is_new else shown[row, joint])
            for frame in range(len(now)):
                last = slowed_down(last, read_quaternion(now[frame]), cosine)
                write_quaternion(now[frame], last)
            write_quaternion(shown[row, joint], last)
