"""IdleMotion of the body that no sound drives: breath, shifts of weight, small turns of the head. Not in the paper.

In silence the model's codes come to rest, and so would the body. Breath goes on always; weight and head move only while
nothing else does, and fade where sound or an action takes over. When what happens follows from the session's seed and
the frame alone, so a session that is taken back breathes on as it did.

A shift of weight carries the hips sideways over both ankles, legs and all, as a parallelogram does: feet stay planted.
Every chunk of every session comes through here, so the loop over its frames is compiled.
"""

import math

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernels import kernel
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize

from .kinematics import Skeleton
from .kinematics.quaternions import (
    conjugate,
    from_rotation_vector,
    multiply,
    normalized,
    plus,
    read_quaternion,
    read_vector,
    rotate,
    write_quaternion,
)
from .motion_chunk import MotionChunk
from .stages.modes import FREE, MotionOptions

UPPER = ("spine", "chest", "upperChest", "neck", "head", "leftShoulder", "rightShoulder")
BREATH = np.array(  # radians at full lungs, of the same joints: backwards, and shoulders up
    [[-0.006, 0], [-0.016, 0], [-0.018, 0], [0.016, 0], [0.014, 0], [0, 0.022], [0, -0.022]]
)
TURNED = np.array([0, 0, 0, 0.4, 0.6, 0, 0])  # share of a turn of the head
LEGS = tuple(f"{side}{part}" for side in ("left", "right") for part in ("UpperLeg", "LowerLeg", "Foot"))
BREATH_S, INHALE = 4.2, 0.4  # a breath, and the share of it that goes in
SHIFT_EVERY_S, SHIFT_S, SHIFT_M = (
    7.0,
    2.2,
    0.022,
)  # one shift in each stretch, how long it takes, how far at most
SWAY_M, SWAY_HZ = 0.003, (0.13, 0.29)  # that nobody who stands is without
TURN_EVERY_S, TURN_S, AHEAD = 4.0, 0.9, 0.4  # the head is straight in that share of the stretches
TURN_YAW, TURN_PITCH = math.radians(9), math.radians(3)
RISE_S, FALL_S = 1.6, 0.5  # until it moves freely, and until it leaves the body to what takes over
KEPT = 64  # chunks whose end is known

_WEIGHT, _YAW, _PITCH = 1, 2, 3  # what numbers are drawn for
_MIX = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
_30, _27, _31, _11 = (np.uint64(bits) for bits in (30, 27, 31, 11))


@kernel()
def eased(share):  # type: ignore[no-untyped-def]
    """0 to 1 without a step in speed or acceleration."""
    return share * share * share * (10 - share * (15 - 6 * share))


@kernel()
def number(seed, what, stretch):  # type: ignore[no-untyped-def]
    """In 0..1, by seed, purpose and place alone (the finish of SplitMix64)."""
    x = seed * _MIX[0] + np.uint64(what) * _MIX[1] + np.uint64(stretch) * _MIX[2]
    for _ in range(2):
        x = (x ^ (x >> _30)) * _MIX[1]
        x = (x ^ (x >> _27)) * _MIX[2]
        x = x ^ (x >> _31)
    return (x >> _11) / 9007199254740992.0


@kernel()
def place_of(seed, what, stretch, still):  # type: ignore[no-untyped-def]
    """Where a stretch of time leads to."""
    if stretch < 0 or number(seed, what + 16, stretch) < still:
        return 0.0
    return 2 * number(seed, what, stretch) - 1


@kernel()
def drawn(seed, what, frame, every_s, takes_s, still):  # type: ignore[no-untyped-def]
    """From one place in -1..1 to another in each stretch of time, smoothly; `still` is the share that is 0."""
    every = int(round(every_s * FRAME_RATE_HZ))
    takes = takes_s * FRAME_RATE_HZ
    stretch, since = frame // every, frame % every
    old, new = place_of(seed, what, stretch - 1, still), place_of(seed, what, stretch, still)
    begins = number(seed, what + 8, stretch) * (every - takes)
    return old + (new - old) * eased(min(max((since - begins) / takes, 0.0), 1.0))


@kernel()
def breath(second, seed):  # type: ignore[no-untyped-def]
    """How full the lungs are, 0 to 1: quickly in, slowly out."""
    place = (second / BREATH_S + (seed % np.uint64(11)) / 11.0) % 1.0
    return eased(place / INHALE) if place < INHALE else 1 - eased((place - INHALE) / (1 - INHALE))


@kernel()
def shift(rotations, root, offsets, legs, metres):  # type: ignore[no-untyped-def]
    """The hips of one frame carried to the body's left over feet that stay."""
    hips = read_quaternion(rotations[legs[0]])
    ahead = rotate(hips, (0.0, 0.0, 1.0))
    level = max(math.sqrt(ahead[0] ** 2 + ahead[2] ** 2), 1e-6)
    east = north = 0.0
    for k in range(2):
        upper, lower, foot = legs[1 + 3 * k], legs[2 + 3 * k], legs[3 + 3 * k]
        thigh = multiply(hips, read_quaternion(rotations[upper]))
        shin = multiply(thigh, read_quaternion(rotations[lower]))
        sole = multiply(shin, read_quaternion(rotations[foot]))
        leg = plus(rotate(thigh, read_vector(offsets[lower])), rotate(shin, read_vector(offsets[foot])))
        angle = -metres / max(-leg[1], 0.1)
        roll = from_rotation_vector((ahead[0] / level * angle, 0.0, ahead[2] / level * angle))
        rolled = rotate(roll, leg)
        east += (leg[0] - rolled[0]) / 2
        north += (leg[2] - rolled[2]) / 2
        new_thigh, new_foot = multiply(roll, thigh), multiply(conjugate(multiply(roll, shin)), sole)
        write_quaternion(rotations[upper], normalized(multiply(conjugate(hips), new_thigh)))
        write_quaternion(rotations[foot], normalized(new_foot))
    root[0] += east
    root[2] += north


@kernel()
def enliven(rotations, root, offsets, upper, legs, shares, first, seed, may_shift):  # type: ignore[no-untyped-def]
    """Breath, and as far as `shares` of each frame allow, turns of the head and shifts of weight."""
    for t in range(rotations.shape[0]):
        frame, share = first + t, eased(shares[t])
        second = frame / FRAME_RATE_HZ
        full = breath(second, seed)
        yaw = TURN_YAW * share * drawn(seed, _YAW, frame, TURN_EVERY_S, TURN_S, AHEAD)
        pitch = TURN_PITCH * share * drawn(seed, _PITCH, frame, TURN_EVERY_S, TURN_S, AHEAD)
        for k in range(upper.shape[0]):
            if upper[k] >= 0:
                x, z = BREATH[k, 0] * full + TURNED[k] * pitch, BREATH[k, 1] * full
                by, own = from_rotation_vector((x, TURNED[k] * yaw, z)), rotations[t, upper[k]]
                write_quaternion(own, normalized(multiply(read_quaternion(own), by)))
        if may_shift and share > 0:
            sway = math.sin(2 * math.pi * SWAY_HZ[0] * second + seed % np.uint64(7))
            sway += math.sin(2 * math.pi * SWAY_HZ[1] * second)
            weight = drawn(seed, _WEIGHT, frame, SHIFT_EVERY_S, SHIFT_S, 0.0)
            shift(rotations[t], root[t], offsets, legs, share * (weight * SHIFT_M + sway / 2 * SWAY_M))


class IdleMotion:
    """One session's."""

    def __init__(self, seed: int, options: MotionOptions = FREE, chunk: ChunkSize = CHUNK) -> None:
        self._frames = chunk.frames
        self._seed = np.uint64(seed % 2**64)
        self._may_shift = not (options.in_place or options.upper_body)
        self._ends: dict[int, float] = {}  # by chunk: how free it was at its end, 0 to 1

    def apply(self, chunk: int, motion: MotionChunk, skeleton: Skeleton, *, is_idle: bool) -> MotionChunk:
        """A chunk with life on top; `is_idle` where nothing else moves the body."""
        rotations, root = motion.rotations.astype(np.float32), motion.root.astype(np.float64)
        upper = np.array([_place(skeleton, name) for name in UPPER])
        legs = np.array([_place(skeleton, name) for name in ("hips", *LEGS)])
        may_shift = self._may_shift and legs.min() >= 0
        offsets = skeleton.offsets.numpy()
        shares = self._shares(chunk, is_idle=is_idle)
        enliven(rotations, root, offsets, upper, legs, shares, chunk * self._frames, self._seed, may_shift)
        return motion._replace(rotations=rotations, root=root.astype(motion.root.dtype))

    def _shares(self, chunk: int, *, is_idle: bool) -> Float[np.ndarray, " t"]:
        begin = self._ends.get(chunk - 1, 1.0 if chunk == 0 else 0.0)
        pace = 1 / (RISE_S * FRAME_RATE_HZ) if is_idle else -1 / (FALL_S * FRAME_RATE_HZ)
        path = np.clip(begin + pace * np.arange(1, self._frames + 1), 0, 1)
        self._ends[chunk] = float(path[-1])
        for old in [known for known in self._ends if known < chunk - KEPT]:
            del self._ends[old]
        return np.asarray(path)


def warm_up(skeleton: Skeleton) -> None:
    """Compile the loop, once on a machine."""
    still = np.zeros((CHUNK.frames, skeleton.joints, 4), np.float32)
    still[..., 0] = 1
    IdleMotion(0).apply(0, MotionChunk(still, np.zeros((CHUNK.frames, 3), np.float32)), skeleton, is_idle=True)


def _place(skeleton: Skeleton, name: str) -> int:
    return skeleton.index(name) if name in skeleton.names else -1
