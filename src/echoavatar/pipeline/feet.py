"""Planted feet are held by leg IK, streaming; released feet return to the decoded path without a step.

`ground` moves the root so that the leading foot stays; what is left is that two planted feet do not agree with each
other, and that the decoded foot floats or sinks by millimetres. A foot is planted by the height and vertical speed of
its ball, as in `kinematics.contact`. While it is, its ball is held where it came down; the correction fades when it
lifts. A foot that travels without lifting, as a shuffle decodes, is lifted, so that it steps instead of sliding. Not in
the paper.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..kinematics import Skeleton, forward_kinematics
from ..kinematics.two_bone import reach
from ..nn import StreamState, write_rows
from .ground import leg_chain

ENTER_HEIGHT, LEAVE_HEIGHT = 0.022, 0.035  # metres above standing height
LEAVE_SPEED = 0.30  # metres per second, vertical
FADE = 0.78  # of a correction, what is left one frame after the foot was lifted
SETTLE = 0.35  # of the height error, what is taken away per planted frame
LARGEST = 0.12  # metres: a foot that strays further is let go
STANDING_SPEED, STEPPING_SPEED = (
    0.3,
    0.8,
)  # metres per second, horizontal: below it may be planted; above it steps
CLEARANCE = 0.045  # metres over the floor of a stepping foot
RISE = 0.5  # of the way to its clearance, per frame


@dataclass
class FeetState(StreamState):
    """Per row and foot: is it held, where, by how much it is moved, and the decoded ball in the last frame."""

    held: Bool[Tensor, "b f"]
    anchor: Float[Tensor, "b f 2"]
    shift: Float[Tensor, "b f 3"]
    ball: Float[Tensor, "b f 3"]
    seen: Bool[Tensor, " b"]


class Feet:
    """Foot lock for a rig with two legs of two bones and toes; rigs without are passed through."""

    def __init__(self, skeleton: Skeleton) -> None:
        feet = skeleton.config.feet
        self.is_able = len(feet) == 4
        if not self.is_able:
            return
        self._chain = leg_chain(skeleton)
        self._joints = skeleton.indices(self._chain.names)
        self._ankles = [self._chain.names.index(skeleton.names[feet[side]]) for side in (0, 2)]
        self._balls = [self._chain.names.index(skeleton.names[feet[side]]) for side in (1, 3)]
        self._knees = [self._chain.parents[joint] for joint in self._ankles]
        self._hips = [self._chain.parents[joint] for joint in self._knees]
        self._standing = skeleton.rest_positions[[feet[1], feet[3]], 1]

    def init_state(self, rows: int) -> FeetState:
        """No foot is held."""
        no = torch.zeros(rows, 2, dtype=torch.bool)
        seen = torch.zeros(rows, dtype=torch.bool)
        return FeetState(no, torch.zeros(rows, 2, 2), torch.zeros(rows, 2, 3), torch.zeros(rows, 2, 3), seen)

    def step(
        self,
        rotations: Float[Tensor, "b t j 3 3"],
        root: Float[Tensor, "b t 3"],
        state: FeetState,
        active: Bool[Tensor, " b"],
        fps: float,
    ) -> Float[Tensor, "b t j 3 3"]:
        """The same rotations with the legs corrected."""
        if not self.is_able:
            return rotations
        local = rotations[:, :, self._joints]
        pose = forward_kinematics(self._chain, local, root)
        shift = self._shifts(pose.positions[:, :, self._balls], state, active, fps)
        local = self._bent(local, pose.rotations, pose.positions, shift)
        corrected = rotations.clone()
        corrected[:, :, self._joints] = local
        return corrected

    def _shifts(
        self, balls: Float[Tensor, "b t f 3"], state: FeetState, active: Tensor, fps: float
    ) -> Float[Tensor, "b t f 3"]:
        """By how much each foot is moved, frame by frame."""
        over = balls - torch.tensor([0.0, 1.0, 0.0]) * self._standing[:, None]
        held, anchor, shift = state.held.clone(), state.anchor.clone(), state.shift.clone()
        before = torch.where(state.seen[:, None, None], state.ball, over[:, 0])
        shifts = []
        for t in range(balls.shape[1]):
            place, height = over[:, t][..., [0, 2]], over[:, t, :, 1]
            moved = (over[:, t] - before) * fps
            rising, travel = moved[..., 1].abs(), moved[..., [0, 2]].norm(dim=-1)
            low = torch.where(held, height < LEAVE_HEIGHT, height < ENTER_HEIGHT) & (rising < LEAVE_SPEED)
            low &= held | (travel < STANDING_SPEED)
            down = low & ~held
            anchor = torch.where(down[..., None], place + shift[..., [0, 2]], anchor)
            gap = anchor - place
            low &= gap.norm(dim=-1) < LARGEST
            stepping = (travel - STANDING_SPEED) / (STEPPING_SPEED - STANDING_SPEED)
            lift = (CLEARANCE * stepping.clamp(0, 1) - height).clamp_min(0) * (travel > STANDING_SPEED)
            risen = torch.where(lift > 0, shift[..., 1] + RISE * (lift - shift[..., 1]), shift[..., 1] * FADE)
            faded = torch.stack([shift[..., 0] * FADE, risen, shift[..., 2] * FADE], -1)
            planted = torch.stack(
                [gap[..., 0], shift[..., 1] - SETTLE * (height + shift[..., 1]), gap[..., 1]], -1
            )
            shift = torch.where(low[..., None], planted, faded)
            held, before = low, over[:, t]
            shifts.append(shift)
        write_rows(state.held, held, active)
        write_rows(state.anchor, anchor, active)
        write_rows(state.shift, shift, active)
        write_rows(state.ball, before, active)
        write_rows(state.seen, torch.ones_like(state.seen), active)
        return torch.stack(shifts, 1)

    def _bent(
        self,
        local: Float[Tensor, "b t c 3 3"],
        turns: Float[Tensor, "b t c 3 3"],
        places: Float[Tensor, "b t c 3"],
        shift: Float[Tensor, "b t f 3"],
    ) -> Float[Tensor, "b t c 3 3"]:
        """Local rotations of the chain with both ankles moved by `shift`, feet keeping their world orientation."""
        thigh, shin = reach(
            hip=places[:, :, self._hips],
            knee=places[:, :, self._knees],
            ankle=places[:, :, self._ankles],
            hinge=turns[:, :, self._knees, :, 0],
            target=places[:, :, self._ankles] + shift,
        )
        above = turns[:, :, [self._chain.parents[joint] for joint in self._hips]]
        upper, lower = thigh @ turns[:, :, self._hips], shin @ turns[:, :, self._knees]
        local = local.clone()
        local[:, :, self._hips] = above.mT @ upper
        local[:, :, self._knees] = upper.mT @ lower
        local[:, :, self._ankles] = lower.mT @ turns[:, :, self._ankles]
        return local
