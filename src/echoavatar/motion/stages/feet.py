"""Planted feet are held by leg IK; released feet return smoothly to the decoded path.

`ground` moves the root so that the leading foot stays. Three errors remain: two planted feet do not agree with each
other, the decoded foot floats or sinks by millimetres, and `leash` may have moved the root.

- A foot is planted while its ball is low and does not rise fast. Its ball is then held where it was first shown.
- A released foot rises before it travels: the closer it is to the floor, the less of its way it makes, and the more
  slowly the correction fades. So it does not slide.
- A foot that is held too far from its decoded place is released, and steps there.
- A foot that travels without lifting, as in a decoded shuffle, is lifted, so that it steps instead of sliding.

Not in the paper.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel

from ..ik.limbs import ChainPose, Chains, bend, legs_of
from ..kinematics import Skeleton
from ..kinematics.quaternions import minus, read_quaternion, read_vector, rotate, rotate_back, write_vector
from .pose import Array, Pose

ENTER_HEIGHT, LEAVE_HEIGHT = 0.022, 0.035  # metres above standing height
LEAVE_SPEED = 0.30  # metres per second, upwards
FADE = 0.78  # share of a correction that remains after a frame in the air
SETTLE = 0.35  # share of the height error that is removed per planted frame
LARGEST = 0.12  # metres: the farthest that a foot is held from its decoded place
LARGEST_ON_LEASH = 0.30  # the same in rows with a leash or in place
BACK = 0.015  # metres from its decoded place within which a released foot may be planted again
STANDING_SPEED, STEPPING_SPEED = 0.3, 0.8  # m/s, along the floor: below it a foot may be planted; above, it steps
CLEARANCE = 0.045  # metres: height of a stepping foot
CLEAR = 0.035  # metres above the floor from which a foot travels, and its correction fades, at full speed
RISE = 0.5  # share of the missing height that a frame adds


@dataclass
class FeetState(StreamState):
    """Both feet of each session, left first."""

    seen: Bool[Array, "b 2"]
    held: Bool[Array, "b 2"]
    let_go: Bool[Array, "b 2"]  # released and on the way to its decoded place, not to be held before it arrives
    shown: Float[Array, "b 2 2"]  # where its ball was shown, along x and z
    moved: Float[Array, "b 2 3"]  # its correction
    ball: Float[Array, "b 2 3"]  # where its ball was without the leash; height is above the standing height

    def lean(self) -> Float[Array, " b"]:
        """The largest horizontal distance between a held foot of each row and its decoded place, metres."""
        lean: Array = (np.hypot(self.moved[:, :, 0], self.moved[:, :, 2]) * self.held).max(-1)
        return lean


class Feet:
    """Foot lock for a rig with two legs of two bones; the motion of other rigs passes unchanged."""

    def __init__(self, skeleton: Skeleton, chains: Chains) -> None:
        self._legs = legs_of(skeleton, chains)
        if self._legs is not None:
            self._standing = skeleton.rest_positions[self._legs.joints[:, 3], 1]

    def init_state(self, rows: int) -> FeetState:
        """No foot is held."""
        seen, held, let_go = (np.zeros((rows, 2), np.bool_) for _ in range(3))
        shown, moved, ball = (np.zeros((rows, 2, size), np.float32) for size in (2, 3, 3))
        return FeetState(seen, held, let_go, shown, moved, ball)

    def step(
        self,
        pose: Pose,
        chains: ChainPose,
        state: FeetState,
        active: Bool[Array, " b"],
        *,
        decoded_root: Float[Array, "b t 3"],
        largest: Float[Array, " b"],
    ) -> None:
        """Bend the legs of `pose` in place so that planted feet stay; `chains` is the pose's.

        `decoded_root` is the root before the leash, by which feet are judged to stand or step. `largest` is how far a
        foot may be held from its decoded place, metres, per row.
        """
        if self._legs is not None:
            poses, memory = (chains, pose.rotations, pose.root, decoded_root), tuple(vars(state).values())
            lock(self._legs, self._standing, *poses, pose.fps, largest, memory, active)


@kernel()
def lift_of(height, speed, away):  # type: ignore[no-untyped-def]
    """Metres by which a foot that is not held should be raised, for its height, speed and horizontal correction."""
    stepping = (speed - STANDING_SPEED) / (STEPPING_SPEED - STANDING_SPEED)
    lift = CLEARANCE * min(stepping, 1.0) - height if stepping > 0.0 else 0.0
    if away > BACK:
        lift = max(lift, min(2.0 * away, CLEARANCE) - height)
    return lift


@kernel()
def how_clear(height):  # type: ignore[no-untyped-def]
    """0 on the floor to 1 where a foot may travel at full speed."""
    return min(max(height / CLEAR, 0.0), 1.0)


@kernel()
def correction(ball, free_ball, fps, largest, memory, row, side):  # type: ignore[no-untyped-def]
    """The correction of a foot in a frame, metres; advances the memory of that foot.

    `ball` is the position of its ball, with the height above the standing height; `free_ball` is the same without the
    leash.
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
    lands = stays and height < ENTER_HEIGHT and speed < STANDING_SPEED and not let_go
    is_held = stays if was_held else lands
    gap_x, gap_z = x - ball[0], z - ball[2]  # to its place in the frame before, as shown
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
    """Hold the feet of active rows, frame by frame and foot by foot."""
    for row in range(len(rotations)):
        if not active[row]:
            continue
        for frame in range(rotations.shape[1]):
            hips = read_quaternion(rotations[row, frame, 0])
            world, places = chains.rotations[row, frame], chains.places[row, frame]
            here, free = root[row, frame], free_root[row, frame]
            for side in range(2):
                x, y, z = rotate(hips, read_vector(places[legs.slots[side, 3]]))
                y -= standing[side]
                ball = (x + here[0], y + here[1], z + here[2])
                free_ball = (x + free[0], y + free[1], z + free[2])
                shift = correction(ball, free_ball, fps, largest[row], memory, row, side)
                bend(legs, side, rotations[row, frame], world, places, rotate_back(hips, shift))
