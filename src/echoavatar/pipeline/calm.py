"""Trembling taken out as it comes, and a bound on how fast a joint may turn.

Sampled codes carry noise that a decoder cannot tell from motion. Each joint follows the decoded rotation by a share of
the way: half of it when the way is short, all of it when the joint really moves, so that slow trembling is halved in
one frame and quick strokes keep their time. No joint turns faster than `FASTEST`. Not in the paper.
"""

import math
from dataclasses import dataclass

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
SLOW_SHARE = 0.5  # of the way that a resting joint follows in one frame: a delay of one frame
SURELY_MOVING = math.radians(240)  # per second: from here on a joint follows at once


@dataclass
class CalmState(StreamState):
    """The last rotations shown."""

    last: Float[Tensor, "b j 4"]
    seen: Bool[Tensor, " b"]


class Calm:
    """An adaptive low-pass on joint rotations, streaming; the first frame passes as it is."""

    def __init__(self, joints: int) -> None:
        self._joints = joints

    def init_state(self, rows: int) -> CalmState:
        """Nothing shown yet."""
        return CalmState(torch.zeros(rows, self._joints, 4), torch.zeros(rows, dtype=torch.bool))

    def step(
        self, rotations: Float[Tensor, "b t j 4"], state: CalmState, active: Bool[Tensor, " b"], fps: float
    ) -> Float[Tensor, "b t j 4"]:
        """Unit quaternions `wxyz` in and out, frame by frame."""
        last = torch.where(state.seen[:, None, None], state.last, rotations[:, 0])
        shown = []
        for frame in rotations.unbind(1):
            way = axis_angle_from_quaternion(quaternion_multiply(quaternion_conjugate(last), frame))
            angle = way.norm(dim=-1, keepdim=True)
            share = SLOW_SHARE + (1 - SLOW_SHARE) * (angle * fps / SURELY_MOVING).clamp(max=1)
            share = torch.minimum(share, FASTEST / fps / angle.clamp_min(1e-9))
            last = quaternion_multiply(last, quaternion_from_axis_angle(way * share))
            last = last / last.norm(dim=-1, keepdim=True)
            shown.append(last)
        write_rows(state.last, last, active)
        write_rows(state.seen, torch.ones_like(state.seen), active)
        return torch.stack(shown, 1)
