"""A hand that hardly moves rests; one that gestures is hardly delayed, and the trunk moves with it.

Codes are drawn anew for every motion token, and one code holds both arms. While one hand works, the draws also move the
other, and no hand ever comes to rest. People's hands do: they rest, and they stay up, with small moves. So each arm
passes a low-pass filter whose cutoff rises with the speed v of its wrist (after the 1 euro filter: Casiez, Roussel and
Vogel 2012, whose cutoff is linear in the speed). While one talks, `LEAK` of the other wrist's speed does not count. A
hand that stays behind catches up:

    cutoff = STILL_HZ + GAIN_HZ max(v - LEAK w, CATCH_UP d, TRAVEL u)^2

v and w are the speeds of its own and the other wrist as decoded, in arm lengths per second, averaged over `AVERAGE_S`
of the frames before or, where that is more, of those that the chunk holds after it: so a stroke begins on time. d is
how many arm lengths the hand is behind, u the speed of the hips in metres per second: a dancer's arms pass freely. At
v = 0.2 beside a resting hand it follows with a time constant of 0.6 s, at 1 of 30 ms.

People's trunks move when their hands do. So each turn of the spine's joints is shown at a rate between `CALM` and
`CALM` + `TAKES_PART`, which grows with the speed of the faster hand (at `HALF` by half of it); the difference to the
decoded spine fades within `FORGOTTEN_S`. A trunk is heavy, and people's hardly moves above 2 Hz, so a low-pass filter
of `TRUNK_HZ` comes first: otherwise fast changes of the codes would be enlarged into a shake. No talker leans far to a
side for seconds, as generated ones may, so the roll of the spine is bounded softly by `MOST_ROLL`. While the hips
travel, the trunk passes as decoded.

Where a hand should rest, or gestures should be smaller or larger, each arm moves `size` times as far from its place,
the mean within `PLACE_S`, and the trunk as the arm with the larger size; the timing of strokes stays. The generator
also holds a speaker's hands too far from the body. So the elbow is drawn back, the forearm folds and the arm turns
aside, by `DRAWN`, `FOLDED` and `OPENED` times the distance of the hand's place: the hands come nearer at the height
they had, and strokes keep their length. All this ends as the hips travel. Generated legs stand so close together that
weight cannot shift between them: each is turned outwards by `PARTED`. None of this applies to dances. Not in the paper.
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
    between,
    conjugate,
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
from .carriage import raise_shoulder, turn_hips
from .pose import Array, Pose

STILL_HZ, GAIN_HZ, LEAK = 0.05, 5.0, 0.8
AVERAGE_S, CATCH_UP, TRAVEL, TRAVEL_S = 0.12, 1.4, 2.0, 0.5
CALM, TAKES_PART, HALF, FORGOTTEN_S = 0.1, 2.45, 0.5, 1.0
TRUNK_HZ = 1.2
PLACE_S, SIZE_S = 2.0, 0.15  # within which a hand's place is a mean, and a new size is reached
DRAWN, FOLDED, OPENED = 0.5, 0.2, 0.25  # radians an arm length
PARTED = 0.05  # radians by which each leg of a speaker is turned outwards
MOST_ROLL = 0.26  # radians of all joints together: the trunk as a whole leans by half of it
# Sizes of the moves of left and right arm (1: as decoded), and 1 if the speaker talks: here of actions and dances.
WHOLE = np.array([1, 1, 0], np.float32)
ARM = ("Shoulder", "UpperArm", "LowerArm", "Hand")
BONES = (0, 1, 2, 3)  # of an arm by itself
SPINE = ("spine", "chest", "upperChest")
LEG = ("UpperLeg", "LowerLeg", "Foot")


@dataclass
class StillnessState(StreamState):
    """The last frame, if any: arms at size 1 and on average, spine as it came and as shown."""

    arms: Float[Array, "b 2 2 4 4"]
    spine: Float[Array, "b 2 s 4"]
    wrists: Float[Array, "b 2 3"]  # metres, in the chest's frame
    speeds: Float[Array, "b 3"]  # of the wrists, arm lengths per second, and of the hips, metres per second
    hands: Float[Array, "b 3"]  # as `WHOLE`
    has_shown: Bool[Array, " b"]


class Stillness:
    """Filters arms and spine, and moves the legs apart; does nothing on a rig whose arms are not known."""

    def __init__(self, skeleton: Skeleton) -> None:
        names = [[f"{side}{bone}" for bone in ARM] for side in ("left", "right")]
        self._has_arms = all(name in skeleton.names for arm in names for name in arm)
        if self._has_arms:
            legs = [[f"{side}{bone}" for bone in LEG] for side in ("left", "right")]
            known = [skeleton.indices(leg) for leg in legs if all(name in skeleton.names for name in leg)]
            self._legs = np.array(known if len(known) == len(legs) else [], np.int64).reshape(-1, len(LEG))
            self._joints = np.array([skeleton.indices(arm) for arm in names])
            self._spine = np.array(skeleton.indices([bone for bone in SPINE if bone in skeleton.names]), np.int64)
            above = {skeleton.parents[joint] for joint in (*self._spine[:1], *self._legs[:, 0])}
            self._hips = above.pop() if len(above) == 1 and len(self._spine) and len(self._legs) else -1
            self._offsets = np.asarray(skeleton.offsets, np.float64)[self._joints[:, 1:]]
            self._reach = np.linalg.norm(self._offsets[:, 1:], axis=-1).sum(1)

    def init_state(self, rows: int) -> StillnessState:
        """Nothing shown yet."""
        arms, spine, wrists, speeds, hands = (
            np.zeros((rows, *shape), np.float32)
            for shape in ((2, 2, len(ARM), 4), (2, len(SPINE), 4), (2, 3), (3,), (3,))
        )
        return StillnessState(arms, spine, wrists, speeds, hands, np.zeros(rows, bool))

    def step(
        self,
        pose: Pose,
        state: StillnessState,
        active: Bool[Array, " b"],
        hands: Float[Array, "b 3"] | None = None,
        stands: Bool[Array, " b"] | None = None,
    ) -> None:
        """Filter arms, spine and legs of active rows, in place; `hands` as `WHOLE`; hips rest in rows of `stands`."""
        if self._has_arms:
            last = (state.arms, state.spine, state.wrists, state.speeds, state.hands, state.has_shown)
            arms, fps = (self._joints, self._offsets, self._reach), float(pose.fps)
            hands = np.tile(WHOLE, (len(active), 1)) if hands is None else hands
            turns = np.full(len(active), self._hips >= 0) if stands is None or self._hips < 0 else ~stands
            body = (self._hips, self._spine, self._legs)
            rest(pose.rotations, pose.root, *last, hands, active, turns, *body, *arms, fps)


@kernel()
def wrist(rotations, joints, offsets):  # type: ignore[no-untyped-def]
    """Position of a frame's wrist, metres, relative to the shoulder joint, in the axes of that joint's parent."""
    turn, place = IDENTITY, (0.0, 0.0, 0.0)
    for bone in range(len(offsets)):
        turn = multiply(turn, read_quaternion(rotations[joints[bone]]))
        place = plus(place, rotate(turn, read_vector(offsets[bone])))
    return place


@kernel()
def measure(rotations, root, wrists, last, has_shown, joints, offsets, reach, fps, speeds):  # type: ignore[no-untyped-def]
    """Fill `speeds` (t, 5): per wrist the larger mean of frames before and after; the hips'; raw ones of the wrists."""
    average, travel = 1.0 - math.exp(-1.0 / (fps * AVERAGE_S)), 1.0 - math.exp(-1.0 / (fps * TRAVEL_S))
    for side in range(3):
        mean = last[side]
        for frame in range(len(rotations)):
            if side == 2:
                now = math.hypot(root[frame, 0], root[frame, 2]) * fps
                mean += travel * (now - mean)
            else:
                at = wrist(rotations[frame], joints[side], offsets[side])
                now = length(minus(at, read_vector(wrists[side]))) * fps / reach[side] if has_shown or frame else 0.0
                write_vector(wrists[side], at)
                mean += average * (now - mean)
                speeds[frame, side + 3] = now
            speeds[frame, side] = mean
        last[side] = mean
    for side in range(2):
        mean = speeds[len(rotations) - 1, side]
        for back in range(1, len(rotations) + 1):
            frame = len(rotations) - back
            mean += average * (speeds[frame, side + 3] - mean)
            speeds[frame, side] = max(speeds[frame, side], mean)


@kernel()
def take_part(pose, came, shown, spine, speeds, size, has_shown, fps):  # type: ignore[no-untyped-def]
    """Turn the spine of a frame by more where hands move, by less where they rest; `speeds` are the frame's."""
    fast, passes = max(speeds[0], speeds[1]), min(TRAVEL * speeds[2], 1.0)
    rate = size * (CALM + TAKES_PART * fast / (fast + HALF))
    rate += (1.0 - rate) * passes
    roll = 1e-9
    for bone in range(len(spine)):
        roll += 2.0 * math.atan2(pose[spine[bone], 3], pose[spine[bone], 0])
    most = MOST_ROLL / size
    kept = most * math.tanh(roll / most) / roll
    kept += (1.0 - kept) * passes
    forgotten = 1.0 - math.exp(-1.0 / (fps * FORGOTTEN_S))
    follows = 1.0 / (1.0 + fps / (2.0 * math.pi * TRUNK_HZ))
    follows += (1.0 - follows) * passes
    for bone in range(len(spine)):
        own = read_quaternion(pose[spine[bone]])
        now = normalized((own[0], own[1], own[2], own[3] * kept))
        new = now
        if has_shown:
            now = between(read_quaternion(came[bone]), now, follows)
            step = multiply(conjugate(read_quaternion(came[bone])), now)
            new = normalized(multiply(read_quaternion(shown[bone]), between(IDENTITY, step, rate)))
            new = between(new, now, forgotten)
        write_quaternion(came[bone], now)
        write_quaternion(shown[bone], new)
        write_quaternion(pose[spine[bone]], new)


@kernel()
def withdraw(pose, place, joints, offsets, share):  # type: ignore[no-untyped-def]
    """Draw the elbow of a frame back and turn the arm aside, the more, the farther the wrist is in front on average."""
    half = 0.5 * share * max(wrist(place, BONES, offsets)[2], 0.0)
    back, folds = normalized((1.0, half * DRAWN, 0.0, 0.0)), normalized((1.0, -half * FOLDED, 0.0, 0.0))
    upper, lower = read_quaternion(pose[joints[1]]), read_quaternion(pose[joints[2]])
    turned, aside = multiply(back, upper), half * (OPENED if offsets[0][0] > 0.0 else -OPENED)
    write_quaternion(pose[joints[2]], multiply(multiply(conjugate(turned), multiply(folds, upper)), lower))
    write_quaternion(pose[joints[1]], multiply(normalized((1.0, 0.0, aside, 0.0)), turned))


@kernel()
def spread(pose, legs, share):  # type: ignore[no-untyped-def]
    """Move the feet of a frame outwards; each sole is turned as it was."""
    for side in range(len(legs)):
        upper, lower, foot = legs[side]
        thigh, knee = read_quaternion(pose[upper]), read_quaternion(pose[lower])
        shin = multiply(thigh, knee)
        sole = multiply(shin, read_quaternion(pose[foot]))
        out = normalized((1.0, 0.0, 0.0, 0.5 * share * (PARTED if side == 0 else -PARTED)))
        write_quaternion(pose[upper], multiply(out, thigh))
        write_quaternion(pose[foot], multiply(conjugate(multiply(out, shin)), sole))


@kernel()
def rest(  # type: ignore[no-untyped-def]
    rotations,
    root,
    arms,
    trunk,
    wrists,
    last,
    hands,
    has_shown,
    asked,
    active,
    turns,
    hips,
    spine,
    legs,
    joints,
    offsets,
    reach,
    fps,
):
    """Filter arms and spine and spread the legs of active rows, frame by frame."""
    speeds = np.empty((rotations.shape[1], 5))
    settling, growing = 1.0 - math.exp(-1.0 / (fps * PLACE_S)), 1.0 - math.exp(-1.0 / (fps * SIZE_S))
    for row in range(len(rotations)):
        if not active[row]:
            continue
        own = (wrists[row], last[row], has_shown[row])
        measure(rotations[row], root[row], *own, joints, offsets, reach, fps, speeds)
        for frame in range(rotations.shape[1]):
            now = rotations[row, frame]
            for part in range(3):
                hands[row, part] += (growing if has_shown[row] else 1.0) * (asked[row, part] - hands[row, part])
            spread(now, legs, hands[row, 2])
            free = max(1.0 - TRAVEL * speeds[frame, 2], 0.0)
            larger, talks = max(hands[row, 0], hands[row, 1]), free * hands[row, 2]
            take_part(now, trunk[row, 0], trunk[row, 1], spine, speeds[frame], larger, has_shown[row], fps)
            for side in range(len(joints)):
                shown, place = arms[row, 0, side], arms[row, 1, side]
                size = 1.0 + free * (hands[row, side] - 1.0)
                behind = 0.0
                if has_shown[row]:
                    lag = minus(wrist(now, joints[side], offsets[side]), wrist(shown, BONES, offsets[side]))
                    behind = length(lag) / reach[side]
                others = LEAK * hands[row, 2] * speeds[frame, 1 - side]
                pace = max(speeds[frame, side] - others, CATCH_UP * behind)
                pace = max(pace, TRAVEL * speeds[frame, 2])
                cutoff = STILL_HZ + GAIN_HZ * pace * pace
                share = 1.0 / (1.0 + fps / (2.0 * math.pi * cutoff)) if has_shown[row] else 1.0
                for bone in range(joints.shape[1]):
                    joint = joints[side, bone]
                    q = between(read_quaternion(shown[bone]), read_quaternion(now[joint]), share)
                    write_quaternion(shown[bone], q)
                    mean = between(read_quaternion(place[bone]), q, settling if has_shown[row] else 1.0)
                    write_quaternion(place[bone], mean)
                    write_quaternion(now[joint], q if size == 1.0 else between(mean, q, size))
                withdraw(now, place, joints[side], offsets[side], talks / reach[side])
                raise_shoulder(now, joints[side], offsets[side], talks)
            if turns[row]:
                turn_hips(now, hips, spine, legs, talks)
            has_shown[row] = True
