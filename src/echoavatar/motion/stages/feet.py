"""Planted feet are held by leg IK, streaming; released feet return to the decoded path without a step.

`ground` moves the root so that the leading foot stays; what is left is that two planted feet do not agree with each
other, that the decoded foot floats or sinks by millimetres, and whatever `leash` moved the root by. A foot is planted
by the height of its ball and by how fast it rises; one that sinks stays. While it is, its ball is held where it was
shown when it came to stand. A foot that is let go rises before it goes: the less it is off the floor, the less of its
way it makes in that frame, and the correction fades as fast as it was off the floor in the frame before. So it does not
slide, however slowly it is played (`time_warp`). A foot that is held too far from where it was decoded is let go, and
steps there. A foot that travels without lifting, as a shuffle decodes, is lifted, so that it steps instead of sliding.
Not in the paper.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel

from ..ik.chains import ChainPose, Chains
from ..ik.leg import bend, legs_of
from ..kinematics import Skeleton
from ..kinematics.quaternions import (
    minus,
    read_quaternion,
    read_vector,
    rotate,
    rotate_back,
    write_vector,
)
from .pose import Array, Pose

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


@dataclass
class FeetState(StreamState):
    """What is known of both feet of each session, left first."""

    seen: Bool[Tensor, "b 2"]
    held: Bool[Tensor, "b 2"]
    let_go: Bool[Tensor, "b 2"]  # on the way back to where it is decoded, and not held before it is there
    shown: Float[Tensor, "b 2 2"]  # where its ball was shown, along x and z
    moved: Float[Tensor, "b 2 3"]  # by how much it was moved
    ball: Float[Tensor, "b 2 3"]  # where its ball was, without a leash, over its standing height

    def lean(self) -> Float[Array, " b"]:
        """How far the farthest held foot of each row is from where it was decoded, across the floor, metres."""
        moved, held = self.moved.numpy(), self.held.numpy()
        lean: Array = (np.hypot(moved[:, :, 0], moved[:, :, 2]) * held).max(-1)
        return lean


class Feet:
    """Foot lock for a rig with two legs of two bones; rigs without are passed through."""

    def __init__(self, skeleton: Skeleton, chains: Chains) -> None:
        self._legs = legs_of(skeleton, chains)
        if self._legs is not None:
            rest = skeleton.rest_positions.numpy()
            self._standing = rest[self._legs.joints[:, 3], 1].astype(np.float32)

    def init_state(self, rows: int) -> FeetState:
        """No foot is held."""
        seen, held, let_go = (torch.zeros(rows, 2, dtype=torch.bool) for _ in range(3))
        shown, moved, ball = (torch.zeros(rows, 2, size) for size in (2, 3, 3))
        return FeetState(seen, held, let_go, shown, moved, ball)

    def step(
        self,
        pose: Pose,
        chains: ChainPose,
        state: FeetState,
        active: Bool[Array, " b"],
        *,
        decoded_root: Float[Array, "b t 3"] | None = None,
        largest: Float[Array, " b"] | None = None,
    ) -> None:
        """Legs of `pose` bent in place so that planted feet stay; `chains` are those of the pose.

        `decoded_root` is where the root was before a leash: it says which feet stand and which step. `largest` is how
        far a foot may be moved across the floor, metres, per row.
        """
        if self._legs is None:
            return
        free = pose.root if decoded_root is None else decoded_root
        far = np.full(len(pose.root), LARGEST) if largest is None else largest
        memory = tuple(tensor.numpy() for tensor in state.tensors())
        lock(
            self._legs,
            self._standing,
            chains,
            pose.rotations,
            pose.root,
            free,
            pose.fps,
            far,
            memory,
            active,
        )


@kernel()
def lift_of(height, speed, away):  # type: ignore[no-untyped-def]
    """How much a foot that is not held wants to be raised, for its height, its speed and how far it is moved aside."""
    stepping = (speed - STANDING_SPEED) / (STEPPING_SPEED - STANDING_SPEED)
    lift = CLEARANCE * min(stepping, 1.0) - height if stepping > 0.0 else 0.0
    if away > BACK:
        lift = max(lift, min(2.0 * away, CLEARANCE) - height)
    return lift


@kernel()
def how_clear(height):  # type: ignore[no-untyped-def]
    """0 on the floor to 1 where a foot may go as fast as it wants."""
    return min(max(height / CLEAR, 0.0), 1.0)


@kernel()
def correction(ball, free_ball, fps, largest, memory, row, side):  # type: ignore[no-untyped-def]
    """By how much a foot is moved in a frame; the memory of that foot goes on by a frame.

    `ball` is where its ball is, its height over the standing one; `free_ball` is where it would be without a leash.
    """
    seen, all_held, all_let_go, shown, moved, balls = memory
    x, z = shown[row, side, 0], shown[row, side, 1]
    aside_x, up, aside_z = read_vector(moved[row, side])
    last = read_vector(balls[row, side])
    if not seen[row, side]:
        x, z, last = ball[0], ball[2], free_ball
    was_held, let_go = all_held[row, side], all_let_go[row, side]
    before = last[1] + up  # height in the frame before, as shown
    step_x, rise, step_z = minus(free_ball, last)
    height, speed = ball[1], math.hypot(step_x, step_z) * fps
    stays = height < LEAVE_HEIGHT and rise * fps < LEAVE_SPEED
    comes = stays and height < ENTER_HEIGHT and speed < STANDING_SPEED and not let_go
    is_held = stays if was_held else comes
    gap_x, gap_z = x - ball[0], z - ball[2]  # to where it was shown in the frame before
    if is_held and math.hypot(gap_x, gap_z) > largest:
        is_held, let_go = False, True
    if is_held:
        aside_x, aside_z = gap_x, gap_z
        up += SETTLE * (-height - up)
    else:
        away = math.hypot(aside_x, aside_z)
        lift = lift_of(height, speed, away)
        up = up + RISE * (lift - up) if lift > 0.0 else up * FADE
        if was_held:
            rest = 1.0 - how_clear(height + up)
            aside_x, aside_z = aside_x + rest * (gap_x - aside_x), aside_z + rest * (gap_z - aside_z)
        kept = 1.0 - (1.0 - FADE) * how_clear(before)
        aside_x, aside_z = aside_x * kept, aside_z * kept
        let_go = let_go and away > BACK
        x, z = ball[0] + aside_x, ball[2] + aside_z
    seen[row, side], all_held[row, side], all_let_go[row, side] = True, is_held, let_go
    shown[row, side, 0], shown[row, side, 1] = x, z
    write_vector(moved[row, side], (aside_x, up, aside_z))
    write_vector(balls[row, side], free_ball)
    return aside_x, up, aside_z


@kernel()
def lock(legs, standing, chains, rotations, root, free_root, fps, largest, memory, active):  # type: ignore[no-untyped-def]
    """Active rows, frame by frame, one foot after the other."""
    for row in range(len(rotations)):
        if not active[row]:
            continue
        for frame in range(rotations.shape[1]):
            hips = read_quaternion(rotations[row, frame, 0])
            turned, places = chains.rotations[row, frame], chains.places[row, frame]
            here, free = root[row, frame], free_root[row, frame]
            for side in range(2):
                x, y, z = rotate(hips, read_vector(places[legs.slots[side, 3]]))
                y -= standing[side]
                ball = (x + here[0], y + here[1], z + here[2])
                free_ball = (x + free[0], y + free[1], z + free[2])
                shift = correction(ball, free_ball, fps, largest[row], memory, row, side)
                bend(legs, side, rotations[row, frame], turned, places, rotate_back(hips, shift))
