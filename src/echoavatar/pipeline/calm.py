"""Trembling and jumps taken out without delay, and a bound on how fast a joint may turn.

Sampled codes carry noise that a decoder cannot tell from motion, and every latent of 4 frames may begin with a small
step; the first frames of a chunk need not continue the last ones. Each chunk is replaced by the smoothest path that
leaves the frames already shown as they were going and is drawn to the decoded rotations, the more the later in the
chunk (a Whittaker-Henderson smoother with a fixed beginning): it minimises

    sum_k  ((k + 1) / t)^3 |y_k - x_k|^2  +  STIFFNESS |third differences of (shown, y)|^2

over the unit quaternions' four numbers, which is one small matrix. No joint turns faster than `FASTEST`. The paper
smooths nothing; a model sampled at temperature 1 shakes without it.
"""

import math
from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..kinematics.rotations import (
    axis_angle_from_quaternion,
    quaternion_conjugate,
    quaternion_from_axis_angle,
    quaternion_multiply,
)
from ..nn import StreamState, write_rows

FASTEST = math.radians(1000)  # per second
STIFFNESS = 2.0  # 0 shows what was decoded
SHOWN = 3  # frames that a third difference reaches back


@dataclass
class CalmState(StreamState):
    """The last rotations shown."""

    shown: Float[Tensor, "b 3 j 4"]
    seen: Bool[Tensor, " b"]


class Calm:
    """A smoother of joint rotations, streaming by the chunk; the first chunk begins at rest."""

    def __init__(self, joints: int, stiffness: float = STIFFNESS) -> None:
        self._joints, self._stiffness = joints, stiffness

    def init_state(self, rows: int) -> CalmState:
        """Nothing shown yet."""
        return CalmState(torch.zeros(rows, SHOWN, self._joints, 4), torch.zeros(rows, dtype=torch.bool))

    def step(
        self, rotations: Float[Tensor, "b t j 4"], state: CalmState, active: Bool[Tensor, " b"], fps: float
    ) -> Float[Tensor, "b t j 4"]:
        """Unit quaternions `wxyz` in and out, a chunk at a time."""
        before = torch.where(state.seen[:, None, None, None], state.shown, rotations[:, :1])
        path = _one_hemisphere(torch.cat([before, rotations], 1))
        smooth = torch.einsum("st,btjc->bsjc", _smoother(rotations.shape[1], self._stiffness), path)
        shown = _bounded(before[:, -1], smooth / smooth.norm(dim=-1, keepdim=True), FASTEST / fps)
        write_rows(state.shown, torch.cat([before, shown], 1)[:, -SHOWN:], active)
        write_rows(state.seen, torch.ones_like(state.seen), active)
        return shown


@cache
def _smoother(frames: int, stiffness: float) -> Float[Tensor, "t s"]:
    """The matrix from the frames shown and a chunk to the smoothed chunk (t, 3 + t): the minimum, solved once."""
    third = torch.diff(torch.eye(SHOWN + frames, dtype=torch.float64), n=3, dim=0)
    past, own = third[:, :SHOWN], third[:, SHOWN:]
    weight = torch.diag(((torch.arange(frames, dtype=torch.float64) + 1) / frames) ** 3)
    right = torch.cat([-stiffness * own.T @ past, weight], 1)
    smoother: Tensor = torch.linalg.solve(weight + stiffness * own.T @ own, right).float()
    return smoother


def _one_hemisphere(path: Float[Tensor, "b t j 4"]) -> Float[Tensor, "b t j 4"]:
    """Signs chosen so that no quaternion points away from the one before it."""
    flips = (path[:, 1:] * path[:, :-1]).sum(-1, keepdim=True) < 0
    sign = 1.0 - 2.0 * (flips.cumsum(1) % 2)
    return torch.cat([path[:, :1], path[:, 1:] * sign], 1)


def _bounded(
    last: Float[Tensor, "b j 4"], path: Float[Tensor, "b t j 4"], most: float
) -> Float[Tensor, "b t j 4"]:
    """The path followed from `last` on by at most `most` radians a frame."""
    followed = []
    for frame in path.unbind(1):
        way = axis_angle_from_quaternion(quaternion_multiply(quaternion_conjugate(last), frame))
        share = (most / way.norm(dim=-1, keepdim=True).clamp_min(1e-9)).clamp(max=1)
        last = quaternion_multiply(last, quaternion_from_axis_angle(way * share))
        last = last / last.norm(dim=-1, keepdim=True)
        followed.append(last)
    return torch.stack(followed, 1)
