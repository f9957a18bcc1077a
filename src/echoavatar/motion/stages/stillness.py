"""A hand that hardly moves rests; one that gestures is hardly delayed.

Codes are drawn anew for every latent, and one code holds both arms. While one hand works, the draws also move the
other, and no hand ever comes to rest. People's hands do: they rest, and they stay up, with small moves. So each arm
passes a low-pass filter whose cutoff rises with the speed v of its wrist (after the 1 euro filter: Casiez, Roussel and
Vogel 2012, whose cutoff is linear in the speed). `LEAK` of the other wrist's speed does not count, and a hand that
stays behind catches up:

    cutoff = STILL_HZ + GAIN_HZ max(v - LEAK w, CATCH_UP d)^2

v and w are the speeds of its own and the other wrist as decoded, in arm lengths per second, averaged over `AVERAGE_S`;
d is how many arm lengths it is behind. At v = 0.2 beside a resting hand it follows with a time constant of 0.9 s, at 1
of 50 ms. `docs/results/post.md` has what each number changes. Not in the paper.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel

from ..kinematics import Skeleton
from ..kinematics.quaternions import (
    IDENTITY,
    inner_product,
    length,
    minus,
    multiply,
    normalized,
    plus,
    read_quaternion,
    read_vector,
    rotate,
    write_quaternion,
    write_vector,
)
from .pose import Array, Pose

STILL_HZ, GAIN_HZ, LEAK = 0.05, 3.0, 0.3
AVERAGE_S, CATCH_UP = 0.2, 2.0
ARM = ("Shoulder", "UpperArm", "LowerArm", "Hand")


@dataclass
class StillnessState(StreamState):
    """The last frame: arms as shown, wrists as they came (metres, in the chest's frame), their speeds, and if any."""

    shown: Float[Array, "b 2 4 4"]
    wrists: Float[Array, "b 2 3"]
    speeds: Float[Array, "b 2"]
    has_shown: Bool[Array, " b"]


class Stillness:
    """Low-passes the joints of each arm; does nothing on a rig whose arms are not known."""

    def __init__(self, skeleton: Skeleton) -> None:
        names = [[f"{side}{bone}" for bone in ARM] for side in ("left", "right")]
        self._has_arms = all(name in skeleton.names for arm in names for name in arm)
        if self._has_arms:
            self._joints = np.array([skeleton.indices(arm) for arm in names])
            self._offsets = np.asarray(skeleton.offsets, np.float64)[self._joints[:, 1:]]
            self._reach = np.linalg.norm(self._offsets[:, 1:], axis=-1).sum(1)

    def init_state(self, rows: int) -> StillnessState:
        """Nothing shown yet."""
        arms, wrists = np.zeros((rows, 2, len(ARM), 4), np.float32), np.zeros((rows, 2, 3), np.float32)
        return StillnessState(arms, wrists, np.zeros((rows, 2), np.float32), np.zeros(rows, bool))

    def step(self, pose: Pose, state: StillnessState, active: Bool[Array, " b"]) -> None:
        """Filter the arms of active rows, in place."""
        if self._has_arms:
            last = (state.shown, state.wrists, state.speeds, state.has_shown)
            rest(pose.rotations, *last, active, self._joints, self._offsets, self._reach, float(pose.fps))


@kernel()
def wrist(rotations, joints, offsets):  # type: ignore[no-untyped-def]
    """Where a frame's wrist is, from the shoulder's joint and in the frame of its parent."""
    turn, place = IDENTITY, (0.0, 0.0, 0.0)
    for bone in range(len(offsets)):
        turn = multiply(turn, read_quaternion(rotations[joints[bone]]))
        place = plus(place, rotate(turn, read_vector(offsets[bone])))
    return place


@kernel()
def held_wrist(arm, offsets):  # type: ignore[no-untyped-def]
    """`wrist` of an arm's own rotations (4, 4)."""
    turn, place = IDENTITY, (0.0, 0.0, 0.0)
    for bone in range(len(offsets)):
        turn = multiply(turn, read_quaternion(arm[bone]))
        place = plus(place, rotate(turn, read_vector(offsets[bone])))
    return place


@kernel()
def between(a, b, share):  # type: ignore[no-untyped-def]
    """The unit quaternion at this share of the way from a to b."""
    side = -share if inner_product(a, b) < 0.0 else share
    rest = 1.0 - share
    return normalized(
        (a[0] * rest + b[0] * side, a[1] * rest + b[1] * side, a[2] * rest + b[2] * side, a[3] * rest + b[3] * side)
    )


@kernel()
def rest(rotations, shown, wrists, speeds, has_shown, active, joints, offsets, reach, fps):  # type: ignore[no-untyped-def]
    """Filter both arms of active rows, frame by frame."""
    average = 1.0 - math.exp(-1.0 / (fps * AVERAGE_S))
    for row in range(len(rotations)):
        if not active[row]:
            continue
        for frame in range(rotations.shape[1]):
            now = rotations[row, frame]
            for side in range(len(joints)):
                at = wrist(now, joints[side], offsets[side])
                if has_shown[row]:
                    speed = length(minus(at, read_vector(wrists[row, side]))) * fps / reach[side]
                    speeds[row, side] += average * (speed - speeds[row, side])
                write_vector(wrists[row, side], at)
            for side in range(len(joints)):
                behind = length(minus(read_vector(wrists[row, side]), held_wrist(shown[row, side], offsets[side])))
                own = max(speeds[row, side] - LEAK * speeds[row, 1 - side], CATCH_UP * behind / reach[side])
                cutoff = STILL_HZ + GAIN_HZ * own * own
                share = 1.0 / (1.0 + fps / (2.0 * math.pi * cutoff)) if has_shown[row] else 1.0
                for bone in range(joints.shape[1]):
                    joint = joints[side, bone]
                    q = between(read_quaternion(shown[row, side, bone]), read_quaternion(now[joint]), share)
                    write_quaternion(now[joint], q)
                    write_quaternion(shown[row, side, bone], q)
            has_shown[row] = True
