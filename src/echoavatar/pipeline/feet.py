"""Planted feet are held by leg IK, streaming; released feet return to the decoded path without a step.

`ground` moves the root so that the leading foot stays; what is left is that two planted feet do not agree with each
other, that the decoded foot floats or sinks by millimetres, and whatever `leash` moved the root by. A foot is planted
by the height and vertical speed of its ball, as in `kinematics.contact`. While it is, its ball is held where it came
down; the correction fades when it lifts. A foot that is held too far from where it was decoded is let go, and steps
there. A foot that travels without lifting, as a shuffle decodes, is lifted, so that it steps instead of sliding. Not
in the paper.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..ik.chains import Chains
from ..ik.leg import LegReach, legs_of
from ..kinematics import Skeleton, lanes
from ..nn import StreamState
from .pose import Array, Legs, PoseLanes, keep, new_rows, with_past

ENTER_HEIGHT, LEAVE_HEIGHT = 0.022, 0.035  # metres above standing height
LEAVE_SPEED = 0.30  # metres per second, vertical
FADE = 0.78  # of a correction, what is left one frame after the foot was lifted
SETTLE = 0.35  # of the height error, what is taken away per planted frame
LARGEST = 0.12  # metres: a foot that strays further is let go
BACK = 0.015  # metres from its decoded place at which a foot that was let go may stand again
STANDING_SPEED, STEPPING_SPEED = 0.3, 0.8  # m/s, horizontal: below it may be planted; above it steps
CLEARANCE = 0.045  # metres over the floor of a stepping foot
RISE = 0.5  # of the way to its clearance, per frame


_BLOCK = 8  # frames in which a fading correction is written as one product


@dataclass
class FeetState(StreamState):
    """Per row and foot: seen, held, loose (0 or 1), where it is held (2), by how much it is moved (3), its ball (3)."""

    memory: Float[Tensor, "b 11 f"]

    def lean(self) -> Float[Array, " b"]:
        """How far the farthest held foot of each row is from where it was decoded, across the floor, metres."""
        memory = self.memory.numpy()
        lean: Array = (np.hypot(memory[:, 5], memory[:, 7]) * memory[:, 1]).max(-1)
        return lean


class Feet:
    """Foot lock for a rig with two legs of two bones; rigs without are passed through."""

    def __init__(self, skeleton: Skeleton, chains: Chains) -> None:
        legs = legs_of(skeleton)
        self.is_able = legs is not None
        if legs is None:
            return
        self._reach = LegReach(skeleton, legs)
        joints = (legs.thighs, legs.shins, legs.feet)
        self._slots = np.array([[chains.slot[joint] for joint in pair] for pair in joints])
        self._standing = skeleton.rest_positions.numpy()[legs.toes, 1][:, None, None].astype(np.float32)

    def init_state(self, rows: int) -> FeetState:
        """No foot is held."""
        return FeetState(torch.zeros(rows, 11, 2))

    def step(
        self,
        pose: PoseLanes,
        legs: Legs,
        state: FeetState,
        active: Bool[Array, " b"] | None = None,
        *,
        decoded_root: Float[Array, "3 t b"] | None = None,
        largest: Float[Array, " b"] | float = LARGEST,
    ) -> None:
        """Legs of `pose` bent in place so that planted feet stay.

        `decoded_root` is where the root was before a leash: it says which feet stand and which step. `largest` is how
        far a foot may be moved across the floor, metres, per row.
        """
        if not self.is_able:
            return
        balls = legs.points[:, 1::2].copy()
        balls[1] -= self._standing
        over = balls + pose.root[:, None]
        free = over if decoded_root is None else balls + decoded_root[:, None]
        shift = _shifts(over, free, state, active, pose.fps, largest)
        frames = legs.frames[:, :, self._slots]
        aside = lanes.apply_inverse(legs.hips[:, :, None], shift.reshape(3, 2, -1))
        aside += frames[:, 3, 2]
        self._reach.bend(pose.flat(), frames[:, :3, 1], frames[:, 3], aside)


def _shifts(
    over: Float[Array, "3 f t b"],
    free: Float[Array, "3 f t b"],
    state: FeetState,
    active: Bool[Array, " b"] | None,
    fps: float,
    largest: Float[Array, " b"] | float,
) -> Float[Array, "3 f t b"]:
    """By how much each foot is moved; `over` is where its ball is, its height over the standing one.

    `free` is where it would be without a leash.
    """
    memory = state.memory.numpy().transpose(1, 2, 0)
    after = np.empty_like(memory)
    path = with_past(free, memory[8:], new_rows(memory[0, 0]))
    moved = path[:, :, 1:] - path[:, :, :-1]
    height, travel = over[1], np.hypot(moved[0], moved[2])
    stay = (height < LEAVE_HEIGHT) & (np.abs(moved[1]) < LEAVE_SPEED / fps)
    enter = stay & (height < ENTER_HEIGHT) & (travel < STANDING_SPEED / fps)
    shift = np.empty_like(over)
    low, loose = _hold(over[::2], stay, enter, memory, after, shift[::2], largest)
    kept = np.where(low, np.float32(1 - SETTLE), np.float32(FADE))
    added = height * (low * np.float32(-SETTLE))
    if (lift := _lift(travel * fps, height, loose, shift)) is not None:
        is_lifted = ~low & (lift > 0)
        kept[is_lifted], added[is_lifted] = 1 - RISE, RISE * lift[is_lifted]
    up = memory[6]
    for start in range(0, over.shape[2], _BLOCK):
        block = slice(start, start + _BLOCK)
        left = np.cumprod(kept[:, block], axis=1)
        shift[1, :, block] = left * (up[:, None] + np.cumsum(added[:, block] / left, axis=1))
        up = shift[1, :, block][:, -1]
    after[0], after[5:8], after[8:] = 1, shift[:, :, -1], free[:, :, -1]
    keep(state.memory, after.transpose(2, 0, 1), active)
    return shift


def _lift(
    travel: Float[Array, "f t b"],
    height: Float[Array, "f t b"],
    loose: Bool[Array, "f t b"] | None,
    shift: Float[Array, "3 f t b"],
) -> Float[Array, "f t b"] | None:
    """How much higher a foot must be that travels, or goes back to where it was decoded; None where none has to."""
    stepping = (travel - STANDING_SPEED) * (1 / (STEPPING_SPEED - STANDING_SPEED))
    is_stepping = stepping > 0
    if loose is None and not is_stepping.any():
        return None
    lift: Array = (CLEARANCE * np.minimum(stepping, 1) - height) * is_stepping
    if loose is not None:
        np.maximum(lift, (np.minimum(np.hypot(shift[0], shift[2]), CLEARANCE) - height) * loose, out=lift)
    return lift


def _hold(
    place: Float[Array, "2 f t b"],
    stay: Bool[Array, "f t b"],
    enter: Bool[Array, "f t b"],
    memory: Float[Array, "11 f b"],
    after: Float[Array, "11 f b"],
    shift: Float[Array, "2 f t b"],
    largest: Float[Array, " b"] | float,
) -> tuple[Bool[Array, "f t b"], Bool[Array, "f t b"] | None]:
    """Which feet are held, and which are on their way back; writes the horizontal `shift`.

    One round for each stretch of frames in which no foot of any row is set down, lifted or let go.
    """
    held, loose, anchor, aside = memory[1] > 0, memory[2] > 0, memory[3:5], memory[5:8:2]
    all_held, all_loose = np.empty_like(stay), np.zeros_like(stay)
    t, frames, far = 0, stay.shape[1], np.square(largest)
    while t < frames:
        low = np.where(held, stay[:, t], enter[:, t] & ~loose)
        down = low & ~held
        if down.any():
            anchor = np.where(down, place[:, :, t] + aside, anchor)
        gap = anchor[:, :, None] - place[:, :, t:]
        is_far = lanes.dot(gap, gap) > far
        gone = low & is_far[:, 0]
        if gone.any():
            low, loose = low & ~gone, loose | gone
        as_before = np.where(low[:, None], stay[:, t:] & ~is_far, ~enter[:, t:])
        changes = np.flatnonzero(~as_before[:, 1:].all((0, 2)))
        run = int(changes[0]) + 1 if len(changes) else frames - t
        fading = aside[:, :, None] * _fades(run)
        shift[:, :, t : t + run] = np.where(low[:, None], gap[:, :, :run], fading)
        all_held[:, t : t + run] = low[:, None]
        if loose.any():
            is_away = lanes.dot(fading, fading) > BACK**2
            all_loose[:, t : t + run] = loose[:, None] & is_away
            loose = loose & is_away[:, -1]
        held, aside, t = low, shift[:, :, t + run - 1], t + run
    after[1], after[2], after[3:5] = held, loose, anchor
    return all_held, all_loose if all_loose.any() else None


@cache
def _fades(frames: int) -> Float[Array, "t 1"]:
    """What is left of a fading correction, frame by frame."""
    return (FADE ** np.arange(1, frames + 1, dtype=np.float32))[:, None]
