"""Trembling and jumps taken out without delay, and a bound on how fast a joint may turn.

Sampled codes carry noise that a decoder cannot tell from motion, and every latent of 4 frames may begin with a small
step; the first frames of a chunk need not continue the last ones. Each chunk is replaced by the smoothest path that
leaves the frames already shown as they were going and is drawn to the decoded rotations, the more the later in the
chunk (a Whittaker-Henderson smoother with a fixed beginning): it minimises

    sum_k  ((k + 1) / t)^LATE |y_k - x_k|^2  +  STIFFNESS s_k |third difference of (shown, y) that ends in y_k|^2

over the unit quaternions' four numbers, which is one small matrix; and likewise the root's travel. s_k is `BEND` where
a latent begins and 1 elsewhere: there, and only there, acceleration may change at little cost, so that a step is bent
over a whole latent and a chunk is as smooth at its border as within. No joint turns faster than `FASTEST`. The three
numbers make the least jerk at equal distance from what was decoded that leaves no place of a chunk rougher than others
(`docs/results/post.md`). The paper smooths nothing; a model sampled at temperature 1 shakes without it.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN

from ..kinematics.quaternions import (
    inner_product,
    normalized,
    read_quaternion,
    write_quaternion,
    write_vector,
)
from .pose import Array, Pose

FASTEST = math.radians(1000)  # per second
LATE = 10  # power by which the end of a chunk counts more than its beginning
STIFFNESS = 2.0  # 0 shows what was decoded
BEND = 0.01  # of the stiffness, what is left where a latent begins
SHOWN = 3  # frames that a third difference reaches back


@dataclass
class SmootherState(StreamState):
    """The last rotations and travels shown; all zero: none yet."""

    rotations: Float[Tensor, "b 3 j 4"]
    travel: Float[Tensor, "b 3 3"]


class Smoother:
    """A smoother of joint rotations and of the root's travel, streaming by the chunk; the first begins at rest."""

    def __init__(self, joints: int, stiffness: float = STIFFNESS) -> None:
        self._joints, self._stiffness = joints, stiffness

    def init_state(self, rows: int) -> SmootherState:
        """Nothing shown yet."""
        return SmootherState(torch.zeros(rows, SHOWN, self._joints, 4), torch.zeros(rows, SHOWN, 3))

    def step(self, pose: Pose, state: SmootherState, active: Bool[Array, " b"]) -> None:
        """Rotations and travel of the active rows, smoothed in place."""
        shares = _shares(pose.frames, self._stiffness)
        cosine = math.cos(FASTEST / pose.fps / 2)
        shown, travel = state.rotations.numpy(), state.travel.numpy()
        smooth(pose.rotations, pose.root, shown, travel, active, shares, cosine)


@cache
def _shares(frames: int, stiffness: float) -> Float[Array, "t n"]:
    """What each of the frames shown and of a chunk (n = 3 + t) adds to each smoothed frame: the minimum, solved."""
    third = np.diff(np.eye(SHOWN + frames), n=3, axis=0)
    past, own = third[:, :SHOWN], third[:, SHOWN:]
    place = np.arange(frames)
    weight = np.diag(((place + 1) / frames) ** LATE)
    stiff = stiffness * np.where(place % FRAMES_PER_MOTION_TOKEN == 0, BEND, 1.0)[:, None]
    right = np.concatenate([-own.T @ (stiff * past), weight], 1)
    return np.ascontiguousarray(np.linalg.solve(weight + own.T @ (stiff * own), right))


@kernel()
def weighted_sum(shares, path):  # type: ignore[no-untyped-def]
    """Each number of a frame as a sum over all frames of the path (n, 4)."""
    a = b = c = d = 0.0
    for frame in range(len(shares)):
        a += shares[frame] * path[frame, 0]
        b += shares[frame] * path[frame, 1]
        c += shares[frame] * path[frame, 2]
        d += shares[frame] * path[frame, 3]
    return a, b, c, d


@kernel()
def slowed_down(before, after, cosine):  # type: ignore[no-untyped-def]
    """`after`, or the rotation on the way to it that is as far from `before` as half the angle of `cosine` allows."""
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
    """Fill `path` with the frames shown and those of the chunk; in a new session the first frame was shown for ever."""
    for number in range(now.shape[1]):
        for frame in range(SHOWN):
            path[frame, number] = now[0, number] if is_new else past[frame, number]
        for frame in range(len(now)):
            path[SHOWN + frame, number] = now[frame, number]


@kernel()
def turn_to_one_hemisphere(path):  # type: ignore[no-untyped-def]
    """Choose the signs of a path of quaternions so that none points away from the one before it."""
    for frame in range(1, len(path)):
        if inner_product(path[frame - 1], path[frame]) < 0.0:
            path[frame] *= -1.0


@kernel()
def remember(past, path, now):  # type: ignore[no-untyped-def]
    """The last frames shown: those of the chunk, and before them, of a chunk that is shorter, those of the path."""
    for number in range(now.shape[1]):
        for frame in range(SHOWN):
            then = len(now) + frame
            past[frame, number] = path[then, number] if then < SHOWN else now[then - SHOWN, number]


@kernel()
def smooth(rotations, root, shown, travel, active, shares, cosine):  # type: ignore[no-untyped-def]
    """Active rows, joint by joint; `cosine` is that of half the angle that a joint may turn in a frame."""
    frames = rotations.shape[1]
    path = np.zeros((SHOWN + frames, 4))
    for row in range(len(rotations)):
        if not active[row]:
            continue
        is_new = not shown[row, SHOWN - 1, 0].any()
        for joint in range(rotations.shape[2]):
            past, now = shown[row, :, joint], rotations[row, :, joint]
            join(path, past, now, is_new)
            turn_to_one_hemisphere(path)
            last = read_quaternion(path[SHOWN - 1])
            for frame in range(frames):
                last = slowed_down(last, normalized(weighted_sum(shares[frame], path)), cosine)
                write_quaternion(now[frame], last)
            remember(past, path, now)
        join(path, travel[row], root[row], is_new)
        for frame in range(frames):
            write_vector(root[row, frame], weighted_sum(shares[frame], path))
        remember(travel[row], path, root[row])
