"""Trembling and jumps taken out without delay, and a bound on how fast a joint may turn.

Sampled codes carry noise that a decoder cannot tell from motion, and every latent of 4 frames may begin with a small
step; the first frames of a chunk need not continue the last ones. Each chunk is replaced by the smoothest path that
leaves the frames already shown as they were going and is drawn to the decoded rotations, the more the later in the
chunk (a Whittaker-Henderson smoother with a fixed beginning): it minimises

    sum_k  ((k + 1) / t)^4 |y_k - x_k|^2  +  STIFFNESS |third differences of (shown, y)|^2

over the unit quaternions' four numbers, which is one small matrix. No joint turns faster than `FASTEST`. The paper
smooths nothing; a model sampled at temperature 1 shakes without it.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..kinematics import lanes
from ..nn import StreamState
from .pose import Array, PoseLanes, keep, new_rows

FASTEST = math.radians(1000)  # per second
STIFFNESS = 2.0  # 0 shows what was decoded
SHOWN = 3  # frames that a third difference reaches back


@dataclass
class CalmState(StreamState):
    """The last rotations shown; all zero: none yet."""

    shown: Float[Tensor, "b 4 j 3"]


class Calm:
    """A smoother of joint rotations, streaming by the chunk; the first chunk begins at rest."""

    def __init__(self, joints: int, stiffness: float = STIFFNESS) -> None:
        self._joints, self._stiffness = joints, stiffness

    def init_state(self, rows: int) -> CalmState:
        """Nothing shown yet."""
        return CalmState(torch.zeros(rows, 4, self._joints, SHOWN))

    def step(self, pose: PoseLanes, state: CalmState, active: Bool[Array, " b"] | None = None) -> None:
        """Rotations of a chunk, smoothed in place; `active` rows remember them, all for None."""
        turns, shown = pose.turns, state.shown.numpy()
        _, joints, frames, rows = turns.shape
        path = np.empty((4, joints, SHOWN + frames, rows), np.float32)
        path[:, :, :SHOWN] = shown.transpose(1, 2, 3, 0)
        path[:, :, SHOWN:] = turns
        if (is_new := new_rows(lanes.dot(path[:, 0, 0], path[:, 0, 0]))) is not None:
            path[:, :, :SHOWN, is_new] = turns[:, :, :1, is_new]
        _one_hemisphere(path)
        smoother = _smoother(frames, self._stiffness)
        if rows == 1:
            turns[...] = (path[..., 0] @ smoother.T)[..., None]
        else:
            np.matmul(smoother, path, out=turns)
        turns /= np.sqrt(lanes.dot(turns, turns))
        path[:, :, SHOWN:] = turns
        if _bound(path, math.cos(FASTEST / pose.fps / 2)):
            turns[...] = path[:, :, SHOWN:]
        keep(state.shown, path[:, :, frames:].transpose(3, 0, 1, 2), active)


@cache
def _smoother(frames: int, stiffness: float) -> Float[Array, "t s"]:
    """The matrix from the frames shown and a chunk (3 + t) to the smoothed chunk: the minimum, solved once."""
    third = np.diff(np.eye(SHOWN + frames), n=3, axis=0)
    past, own = third[:, :SHOWN], third[:, SHOWN:]
    weight = np.diag(((np.arange(frames) + 1) / frames) ** 4)
    right = np.concatenate([-stiffness * own.T @ past, weight], 1)
    solved = np.linalg.solve(weight + stiffness * own.T @ own, right)
    return solved.astype(np.float32)


def _one_hemisphere(path: Float[Array, "4 j t b"]) -> None:
    """Signs chosen, in place, so that no quaternion points away from the one before it."""
    flips = lanes.dot(path[:, :, 1:], path[:, :, :-1]) < 0
    if flips.any():
        path[:, :, 1:] *= 1 - 2 * (np.cumsum(flips, 1, dtype=np.int32) % 2).astype(np.float32)


def _bound(path: Float[Array, "4 j t b"], cosine: float) -> bool:
    """Joints that turn by more than twice the angle of this cosine in a frame follow their path more slowly.

    Returns whether there were any.
    """
    near = np.abs(lanes.dot(path[:, :, SHOWN:], path[:, :, SHOWN - 1 : -1]))
    if near.min(initial=1) >= cosine:
        return False
    joint, row = np.nonzero((near < cosine).any(1))
    fast = path[:, joint, :, row].transpose(1, 2, 0)  # (4, t, joints that are too fast)
    sine = math.sqrt(1 - cosine**2)
    for t in range(SHOWN, fast.shape[1]):
        last, wanted = fast[:, t - 1], fast[:, t]
        along = lanes.dot(last, wanted)
        wanted = wanted * np.where(along < 0, np.float32(-1), np.float32(1))
        aside = lanes.normalized(wanted - last * np.abs(along))
        followed = lanes.normalized(last * np.float32(cosine) + aside * np.float32(sine))
        fast[:, t] = np.where(np.abs(along) < cosine, followed, wanted)
    path[:, joint, :, row] = fast.transpose(2, 0, 1)
    return True
