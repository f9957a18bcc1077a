"""Planted feet are held by leg IK, streaming; released feet return to the decoded path without a step.

`ground` moves the root so that the leading foot stays; what is left is that two planted feet do not agree with each
other, that the decoded foot floats or sinks by millimetres, and whatever `leash` moved the root by. A foot is planted
by the height of its ball and by how fast it rises; one that sinks stays. While it is, its ball is held where it was
shown when it came to stand. A foot that is let go rises before it goes: the less it is off the floor, the less of its
way it makes in that frame, and the correction fades as fast as it was off the floor in the frame before. So it does not
slide, however slowly it is played (`retime`). A foot that is held too far from where it was decoded is let go, and
steps there. A foot that travels without lifting, as a shuffle decodes, is lifted, so that it steps instead of sliding.
Not in the paper.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..ik.chains import Chains
from ..ik.leg import bend, legs_of
from ..kinematics import Skeleton
from ..kinematics.octets import matrix, place_at, quaternion_at, turned, turned_back
from ..nn import StreamState
from ..nn.compiled import ONE, ZERO, F
from ..nn.octet import exact, inner, load, scratch, store
from .pose import Array, PoseLanes

ENTER_HEIGHT, LEAVE_HEIGHT = 0.022, 0.035  # metres above standing height
LEAVE_SPEED = 0.30  # metres per second, upwards
FADE = 0.78  # of a correction, what is left a frame later in a foot that is off the floor
SETTLE = 0.35  # of the height error, what is taken away per planted frame
LARGEST = 0.12  # metres: a foot that strays further is let go
BACK = 0.015  # metres from its decoded place at which a foot that was let go may stand again
STANDING_SPEED, STEPPING_SPEED = 0.3, 0.8  # m/s, horizontal: below it may be planted; above it steps
CLEARANCE = 0.045  # metres over the floor of a stepping foot
CLEAR = 0.035  # metres off the floor from which on a foot goes, or goes back, as fast as it may
RISE = 0.5  # of the way to its clearance, per frame
_FADE, _SETTLE, _RISE, _CLEARANCE, _BACK = F(FADE), F(SETTLE), F(RISE), F(CLEARANCE), F(BACK**2)
_ENTER, _LEAVE, _LEAVE_SPEED = F(ENTER_HEIGHT), F(LEAVE_HEIGHT), F(LEAVE_SPEED)
_STANDING, _PER_CLEAR, _PER_STEP = F(STANDING_SPEED), F(1 / CLEAR), F(1 / (STEPPING_SPEED - STANDING_SPEED))


@dataclass
class FeetState(StreamState):
    """Per row and foot: seen, held, loose (0 or 1), where it was shown (2), how far it is moved (3), its ball (3)."""

    memory: Float[Tensor, "b 2 11"]

    def lean(self) -> Float[Array, " b"]:
        """How far the farthest held foot of each row is from where it was decoded, across the floor, metres."""
        memory = self.memory.numpy()
        lean: Array = (np.hypot(memory[:, :, 5], memory[:, :, 7]) * memory[:, :, 1]).max(-1)
        return lean


class Feet:
    """Foot lock for a rig with two legs of two bones; rigs without are passed through."""

    def __init__(self, skeleton: Skeleton, chains: Chains) -> None:
        self.legs = legs_of(skeleton, chains)
        self.is_able = self.legs is not None
        if self.legs is not None:
            rest = skeleton.rest_positions.numpy()
            self.standing = rest[self.legs.joints[:, 3], 1].astype(np.float32)

    def init_state(self, rows: int) -> FeetState:
        """No foot is held."""
        return FeetState(torch.zeros(rows, 2, 11))

    def step(
        self,
        pose: PoseLanes,
        frames: Float[Array, "b c 12 8"],
        state: FeetState,
        active: Bool[Array, " b"],
        *,
        decoded_root: Float[Array, "b 3 8"] | None = None,
        largest: Float[Array, " b"] | None = None,
    ) -> None:
        """Legs of `pose` bent in place so that planted feet stay; `frames` are those of the pose in the chains.

        `decoded_root` is where the root was before a leash: it says which feet stand and which step. `largest` is how
        far a foot may be moved across the floor, metres, per row.
        """
        if not self.is_able:
            return
        free = pose.root if decoded_root is None else decoded_root
        far = np.full(len(pose.root), LARGEST, np.float32) if largest is None else largest.astype(np.float32)
        memory, fps = state.memory.numpy(), F(pose.fps)
        lock(
            self.legs,
            self.standing,
            frames,
            pose.turns,
            pose.root,
            free,
            pose.frames,
            fps,
            far,
            memory,
            active,
        )


@exact()
def lock(legs, standing, frames, turns, root, free_root, count, fps, largest, memory, active):  # type: ignore[no-untyped-def]
    """All rows, one foot after the other."""
    over, free, shift = scratch((3, 8)), scratch((3, 8)), scratch((3, 8))
    after = scratch((memory.shape[2],))
    for row in range(turns.shape[0]):
        hips = matrix(quaternion_at(turns, row, 0))
        for side in range(2):
            x, y, z = turned(hips, place_at(frames, row, legs.slots[side, 3]))
            for axis, number in enumerate((x, y - standing[side], z)):
                store(over, (axis,), number + load(root, (row, axis)))
                store(free, (axis,), number + load(free_root, (row, axis)))
            for k in range(after.shape[0]):  # not as a slice: numba would compile the text of its error, too
                after[k] = memory[row, side, k]
            _shift(over, free, count, fps, largest[row], after, shift)
            for k in range(after.shape[0]):
                memory[row, side, k] = after[k] if active[row] else memory[row, side, k]
            moved = (load(shift, (0,)), load(shift, (1,)), load(shift, (2,)))
            bend(legs, side, turns, frames, row, turned_back(hips, moved))


@inner()
def _shift(over, free, count, fps, largest, memory, shift):  # type: ignore[no-untyped-def]
    """By how much a foot is moved, frame by frame; `memory` (11) goes from the frame before to the last one.

    `over` is where its ball is, its height over the standing one; `free` is where it would be without a leash.
    """
    is_new, is_held, is_loose = memory[0] == ZERO, memory[1] > ZERO, memory[2] > ZERO
    x, z = memory[3], memory[4]
    aside_x, up, aside_z = memory[5], memory[6], memory[7]
    last_x, last_y, last_z = memory[8], memory[9], memory[10]
    if is_new:
        x, z, last_x, last_y, last_z = over[0, 0], over[2, 0], free[0, 0], free[1, 0], free[2, 0]
    for t in range(count):
        was_held, before = is_held, last_y + up  # height in the frame before, as shown
        moved_x, rise, moved_z = free[0, t] - last_x, free[1, t] - last_y, free[2, t] - last_z
        last_x, last_y, last_z = free[0, t], free[1, t], free[2, t]
        height, speed = over[1, t], F(math.sqrt(moved_x * moved_x + moved_z * moved_z)) * fps
        stays = height < _LEAVE and rise * fps < _LEAVE_SPEED
        comes = stays and height < _ENTER and speed < _STANDING and not is_loose
        is_held = stays if is_held else comes
        gap_x, gap_z = x - over[0, t], z - over[2, t]  # to where it was shown in the frame before
        if is_held and gap_x * gap_x + gap_z * gap_z > largest * largest:
            is_held, is_loose = False, True
        if is_held:
            aside_x, aside_z = gap_x, gap_z
            up += _SETTLE * (-height - up)
        else:
            away = aside_x * aside_x + aside_z * aside_z
            stepping = (speed - _STANDING) * _PER_STEP
            lift = _CLEARANCE * min(stepping, ONE) - height if stepping > ZERO else ZERO
            if away > _BACK:
                lift = max(lift, min(F(2) * F(math.sqrt(away)), _CLEARANCE) - height)
            up = up + _RISE * (lift - up) if lift > ZERO else up * _FADE
            if was_held:
                rest = ONE - min(max((height + up) * _PER_CLEAR, ZERO), ONE)
                aside_x, aside_z = aside_x + rest * (gap_x - aside_x), aside_z + rest * (gap_z - aside_z)
            kept = ONE - (ONE - _FADE) * min(max(before * _PER_CLEAR, ZERO), ONE)
            aside_x, aside_z = aside_x * kept, aside_z * kept
            is_loose = is_loose and away > _BACK
            x, z = over[0, t] + aside_x, over[2, t] + aside_z
        shift[0, t], shift[1, t], shift[2, t] = aside_x, up, aside_z
    for t in range(count, 8):
        shift[0, t], shift[1, t], shift[2, t] = aside_x, up, aside_z
    memory[0], memory[1], memory[2] = ONE, ONE if is_held else ZERO, ONE if is_loose else ZERO
    memory[3], memory[4], memory[5], memory[6], memory[7] = x, z, aside_x, up, aside_z
    memory[8], memory[9], memory[10] = last_x, last_y, last_z
