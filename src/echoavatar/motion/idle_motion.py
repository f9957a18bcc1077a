"""Idle motion, which no sound drives: breath, shifts of weight, leans of the trunk, looks. Not in the paper.

In silence the model's codes come to rest, and the body would freeze; while it talks, its legs would stand stiff. Breath
always goes on. Weight shifts and the head looks about while nothing else moves the body and, further, while it talks:
the generator keeps the head in one direction; people who talk turn and tilt it every few seconds. The trunk leans in
silence only. Dances and requested actions end all three; a talker's looks fade within some seconds. The times of all
movements are functions of the session's seed and the frame number, so a session that goes back breathes as it did the
first time.

A shift of weight moves the hips sideways over both ankles, as in a parallelogram: the feet stay planted. It also
keeps the hips of a standing or talking body over its feet; generated hips lean past them. The loop over frames is
compiled, because it runs on every chunk of every session.
"""

import math

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernels import kernel
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize

from .kinematics import Motion, Skeleton
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
from .motion_chunk import KEPT, ChunkFade, MotionChunk
from .stages.modes import FREE, MotionOptions

UPPER = ("spine", "chest", "upperChest", "neck", "head", "leftShoulder", "rightShoulder")
BREATH = np.array(  # radians at full lungs, about x and z, of the joints in `UPPER`
    [[-0.006, 0], [-0.016, 0], [-0.018, 0], [0.016, 0], [0.014, 0], [0, 0.022], [0, -0.022]]
)
HEAD_SHARES = np.array([0, 0, 0, 0.4, 0.6, 0, 0])  # of the head's rotation, by joint
LEAN_SHARES = np.array([0.5, 0.3, 0.2, -0.3, -0.4, 0, 0])  # of the trunk's; the head stays nearly upright
LEGS = tuple(f"{side}{part}" for side in ("left", "right") for part in ("UpperLeg", "LowerLeg", "Foot"))
BREATH_S, INHALE = 4.2, 0.4  # length of a breath, and the share of it that goes in
SHIFT_EVERY_S, SHIFT_S = 5.0, 1.6  # there is one shift of weight in each interval, and it takes so long
WAITING_M, TALKING_M = 0.03, 0.15  # the farthest shift to either side
PAST_M, NARROW_M = 0.02, 0.06  # how far past a foot the hips may go; closer feet count as twice NARROW_M apart
FOLLOWS_S = 0.3  # time constant of each of two low-pass filters on the farthest shift and on a talker's looks
PAUSES_S = 2.0  # and of the first one, while looks become smaller: a talker's head stays where it is in short pauses
LEAN_EVERY_S, LEAN_S, UPRIGHT = 5.0, 2.4, 0.2  # the trunk is upright in that share of the intervals
LEAN = math.radians(3)  # the farthest, ahead, back and to either side
SWAY_M, SWAY_HZ = 0.003, (0.13, 0.29)  # the small sway of a standing body
LOOK_EVERY_S, LOOK_S, AHEAD = 4.0, 0.9, 0.4  # the head points ahead in that share of the intervals
LOOKS = np.radians([[9, 3, 0], [18, 15, 12]])  # of one who waits and of one who talks: the farthest yaw, pitch, roll
RISE_S, FALL_S = 1.6, 0.5  # until trunk and head move freely, and until they are still

_WEIGHT, _YAW, _PITCH, _LEAN_AHEAD, _LEAN_ASIDE, _ROLL = range(1, 7)  # purposes of random numbers
_MIX = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
_30, _27, _31, _11 = (np.uint64(bits) for bits in (30, 27, 31, 11))


@kernel()
def smootherstep(share):  # type: ignore[no-untyped-def]
    """As `kinematics.easing.smootherstep`, for one number."""
    return share * share * share * (10 - share * (15 - 6 * share))


@kernel()
def random_number(seed, purpose, interval):  # type: ignore[no-untyped-def]
    """A number in 0..1, a hash of its arguments (the finaliser of SplitMix64)."""
    x = seed * _MIX[0] + np.uint64(purpose) * _MIX[1] + np.uint64(interval) * _MIX[2]
    for _ in range(2):
        x = (x ^ (x >> _30)) * _MIX[1]
        x = (x ^ (x >> _27)) * _MIX[2]
        x = x ^ (x >> _31)
    return (x >> _11) / 9007199254740992.0


@kernel()
def random_target(seed, purpose, interval, zero_share):  # type: ignore[no-untyped-def]
    """The value in -1..1 at which a random path ends an interval."""
    if interval < 0 or random_number(seed, purpose + 16, interval) < zero_share:
        return 0.0
    return 2 * random_number(seed, purpose, interval) - 1


@kernel()
def random_path(seed, purpose, frame, every_s, move_s, zero_share):  # type: ignore[no-untyped-def]
    """A smooth random path in -1..1.

    It moves once in each interval of `every_s` seconds, for `move_s` seconds; a share of its targets is 0.
    """
    every = int(round(every_s * FRAME_RATE_HZ))
    move = move_s * FRAME_RATE_HZ
    interval, since = frame // every, frame % every
    old = random_target(seed, purpose, interval - 1, zero_share)
    new = random_target(seed, purpose, interval, zero_share)
    start = random_number(seed, purpose + 8, interval) * (every - move)
    return old + (new - old) * smootherstep(min(max((since - start) / move, 0.0), 1.0))


@kernel()
def breath(second, seed):  # type: ignore[no-untyped-def]
    """How full the lungs are, 0 to 1: quickly in, slowly out."""
    phase = (second / BREATH_S + (seed % np.uint64(11)) / 11.0) % 1.0
    return smootherstep(phase / INHALE) if phase < INHALE else 1 - smootherstep((phase - INHALE) / (1 - INHALE))


@kernel()
def leg(rotations, offsets, legs, side, hips):  # type: ignore[no-untyped-def]
    """World rotations of a frame's left (0) or right (1) thigh, shin and foot, and the way from hip joint to ankle."""
    upper, lower, foot = legs[1 + 3 * side], legs[2 + 3 * side], legs[3 + 3 * side]
    thigh = multiply(hips, read_quaternion(rotations[upper]))
    shin = multiply(thigh, read_quaternion(rotations[lower]))
    way = plus(rotate(thigh, read_vector(offsets[lower])), rotate(shin, read_vector(offsets[foot])))
    return thigh, shin, multiply(shin, read_quaternion(rotations[foot])), way


@kernel()
def shift_weight(rotations, root, offsets, legs, metres, balance):  # type: ignore[no-untyped-def]
    """Move the hips of one frame to the body's left by `metres`; the feet stay; `balance` 1: hips stay over them."""
    hips = read_quaternion(rotations[legs[0]])
    ahead = rotate(hips, (0.0, 0.0, 1.0))
    level = max(math.sqrt(ahead[0] ** 2 + ahead[2] ** 2), 1e-6)
    ankles = (0.0, 0.0)  # how far to the body's left
    for side in range(2):
        way = leg(rotations, offsets, legs, side, hips)[3]
        at = plus(way, rotate(hips, read_vector(offsets[legs[1 + 3 * side]])))
        ankles = (ankles[1], (ahead[2] * at[0] - ahead[0] * at[2]) / level)
    off = metres - (ankles[0] + ankles[1]) / 2
    most = max(abs(ankles[0] - ankles[1]) / 2, NARROW_M) + PAST_M
    metres += balance * off * ((1 + (off / most) ** 4) ** -0.25 - 1)
    x = y = z = 0.0
    for side in range(2):
        thigh, shin, sole, way = leg(rotations, offsets, legs, side, hips)
        angle = -metres / max(-way[1], 0.1)
        roll = from_rotation_vector((ahead[0] / level * angle, 0.0, ahead[2] / level * angle))
        rolled = rotate(roll, way)
        x += (way[0] - rolled[0]) / 2
        y += (way[1] - rolled[1]) / 2
        z += (way[2] - rolled[2]) / 2
        new_thigh, new_foot = multiply(roll, thigh), multiply(conjugate(multiply(roll, shin)), sole)
        write_quaternion(rotations[legs[1 + 3 * side]], normalized(multiply(conjugate(hips), new_thigh)))
        write_quaternion(rotations[legs[3 + 3 * side]], normalized(new_foot))
    root[0] += x
    root[1] += y
    root[2] += z


@kernel()
def add_idle_motion(rotations, root, offsets, upper, legs, shares, sizes, first, seed):  # type: ignore[no-untyped-def]
    """Add breath, looks and leans times each frame's share, and shifts of weight; `first` numbers the first frame.

    `sizes` (3, 2) are the farthest shift, metres, and a talker's share of looks: low-passed twice, once, and as wanted;
    the first two are updated.
    """
    follows, pauses = 1 - math.exp(-1 / (FOLLOWS_S * FRAME_RATE_HZ)), 1 - math.exp(-1 / (PAUSES_S * FRAME_RATE_HZ))
    for t in range(rotations.shape[0]):
        frame, share = first + t, smootherstep(shares[t])
        second = frame / FRAME_RATE_HZ
        full = breath(second, seed)
        sizes[1, 0] += follows * (sizes[2, 0] - sizes[1, 0])
        sizes[1, 1] += (follows if sizes[2, 1] > sizes[1, 1] else pauses) * (sizes[2, 1] - sizes[1, 1])
        sizes[0] += follows * (sizes[1] - sizes[0])
        shift, talks = sizes[0]
        yaw = (LOOKS[0, 0] * share + LOOKS[1, 0] * talks) * random_path(seed, _YAW, frame, LOOK_EVERY_S, LOOK_S, AHEAD)
        pitch = (LOOKS[0, 1] * share + LOOKS[1, 1] * talks) * random_path(
            seed, _PITCH, frame, LOOK_EVERY_S, LOOK_S, AHEAD
        )
        roll = (LOOKS[0, 2] * share + LOOKS[1, 2] * talks) * random_path(
            seed, _ROLL, frame, LOOK_EVERY_S, LOOK_S, AHEAD
        )
        ahead = LEAN * share * random_path(seed, _LEAN_AHEAD, frame, LEAN_EVERY_S, LEAN_S, UPRIGHT)
        aside = LEAN * share * random_path(seed, _LEAN_ASIDE, frame, LEAN_EVERY_S, LEAN_S, UPRIGHT)
        for k in range(upper.shape[0]):
            if upper[k] >= 0:
                x = BREATH[k, 0] * full + HEAD_SHARES[k] * pitch + LEAN_SHARES[k] * ahead
                z = BREATH[k, 1] * full + LEAN_SHARES[k] * aside + HEAD_SHARES[k] * roll
                added, own = from_rotation_vector((x, HEAD_SHARES[k] * yaw, z)), rotations[t, upper[k]]
                write_quaternion(own, normalized(multiply(read_quaternion(own), added)))
        if shift > 1e-5:
            sway = math.sin(2 * math.pi * SWAY_HZ[0] * second + seed % np.uint64(7))
            sway += math.sin(2 * math.pi * SWAY_HZ[1] * second)
            weight = random_path(seed, _WEIGHT, frame, SHIFT_EVERY_S, SHIFT_S, 0.0)
            metres, balance = shift * weight + share * sway / 2 * SWAY_M, min(shift / WAITING_M, 1.0)
            shift_weight(rotations[t], root[t], offsets, legs, metres, balance)


class IdleMotion:
    """The idle motion of one session."""

    def __init__(self, seed: int, options: MotionOptions = FREE, chunk: ChunkSize = CHUNK) -> None:
        self._frames = chunk.frames
        self._seed = np.uint64(seed % 2**64)
        self._may_shift = not (options.in_place or options.upper_body)
        self._sizes: dict[int, Float[np.ndarray, "2 2"]] = {}  # by chunk: `sizes` of its last frame
        self._fade = ChunkFade(RISE_S, FALL_S, start=1.0, chunk=chunk)

    def apply(
        self, chunk: int, motion: MotionChunk, skeleton: Skeleton, *, is_idle: bool, talks: float = 0.0
    ) -> MotionChunk:
        """The chunk plus idle motion; `is_idle`: nothing else moves the body; `talks`: how lively it talks, 0 to 1."""
        rotations, root = motion.rotations.astype(np.float32), motion.root.astype(np.float64)
        upper = np.array([_joint(skeleton, name) for name in UPPER])
        legs = np.array([_joint(skeleton, name) for name in ("hips", *LEGS)])
        shares, first = self._fade.shares(chunk, is_wanted=is_idle), chunk * self._frames
        farthest = (WAITING_M if is_idle else TALKING_M * talks) * (self._may_shift and legs.min() >= 0)
        wanted = farthest, talks
        sizes = np.array([*self._sizes.get(chunk - 1, (wanted, wanted)), wanted])
        add_idle_motion(rotations, root, skeleton.offsets, upper, legs, shares, sizes, first, self._seed)
        self._sizes[chunk] = sizes[:2]
        self._sizes.pop(chunk - KEPT, None)
        return motion._replace(rotations=rotations, root=root.astype(motion.root.dtype))


def warm_up(skeleton: Skeleton) -> None:
    """Compile the loop; the result is cached on disk."""
    rest = Motion.at_rest(skeleton)
    IdleMotion(0).apply(0, MotionChunk(rest.rotations, rest.root), skeleton, is_idle=True)


def _joint(skeleton: Skeleton, name: str) -> int:
    return skeleton.index(name) if name in skeleton.names else -1
