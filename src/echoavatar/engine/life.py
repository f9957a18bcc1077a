"""Life of the body that no sound drives: breath, shifts of weight, small turns of the head. Not in the paper.

In silence the model's codes come to rest, and so would the body. Breath goes on always; weight and head move only while
nothing else does, and fade where sound or an action takes over. When what happens follows from the session's seed and
the frame alone, so a session that is taken back breathes on as it did.

A shift of weight carries the hips sideways over both ankles, legs and all, as a parallelogram does: feet stay planted.
"""

import hashlib
import math

import numpy as np
from jaxtyping import Float

from ..kinematics import Skeleton, lanes
from ..pipeline import MotionChunk
from ..pipeline.action_overlay import Overlay, laid_on
from ..pipeline.modes import FREE, MotionOptions
from ..timing import CHUNK_FRAMES, FRAME_RATE_HZ

BREATH_S, INHALE = 4.2, 0.4  # a breath, and the share of it that goes in
BREATH = {  # radians at full lungs: backwards, and shoulders up
    "spine": (-0.006, 0, 0),
    "chest": (-0.016, 0, 0),
    "upperChest": (-0.018, 0, 0),
    "neck": (0.016, 0, 0),
    "head": (0.014, 0, 0),
    "leftShoulder": (0, 0, 0.022),
    "rightShoulder": (0, 0, -0.022),
}
SHIFT_EVERY_S, SHIFT_S, SHIFT_M = (
    7.0,
    2.2,
    0.022,
)  # one shift of weight in each stretch, its length, how far at most
SWAY_M = 0.003  # that nobody who stands is without
TURN_EVERY_S, TURN_S = 4.0, 0.9
TURN_YAW, TURN_PITCH = math.radians(9), math.radians(3)
AHEAD = 0.4  # share of the stretches in which the head is straight
RISE_S, FALL_S = 1.6, 0.5  # until it moves freely, and until it leaves the body to what takes over
KEPT = 64  # chunks whose end is known

_LEGS = tuple((f"{side}UpperLeg", f"{side}LowerLeg", f"{side}Foot") for side in ("left", "right"))
Path = Float[np.ndarray, " t"]


class Life:
    """One session's."""

    def __init__(self, seed: int, options: MotionOptions = FREE) -> None:
        self._seed = seed
        self._may_shift = not (options.in_place or options.upper_body)
        self._ends: dict[int, float] = {}  # by chunk: how free it was at its end, 0 to 1

    def alive(self, chunk: int, motion: MotionChunk, skeleton: Skeleton, *, is_idle: bool) -> MotionChunk:
        """A chunk with life on top; `is_idle` where nothing else moves the body."""
        shares, frames = self._shares(chunk, is_idle=is_idle), chunk * CHUNK_FRAMES + np.arange(CHUNK_FRAMES)
        motion = laid_on(motion, self._upper(frames, shares, skeleton), skeleton)
        if not (self._may_shift and shares.any() and set(sum(_LEGS, ("hips",))) <= set(skeleton.names)):
            return motion
        second = frames / FRAME_RATE_HZ
        sway = np.sin(second * 2 * math.pi * 0.13 + self._seed % 7) + np.sin(second * 2 * math.pi * 0.29)
        metres = self._drawn(frames, SHIFT_EVERY_S, SHIFT_S, "shift") * SHIFT_M + sway / 2 * SWAY_M
        return shifted(motion, np.asarray(metres * shares, np.float32), skeleton)

    def _upper(self, frames: np.ndarray, shares: Path, skeleton: Skeleton) -> Overlay:
        joints = tuple(name for name in BREATH if name in skeleton.names)
        turns = breath(frames, self._seed)[:, None, None] * np.array([BREATH[name] for name in joints])
        yaw, pitch = (
            self._drawn(frames, TURN_EVERY_S, TURN_S, way, AHEAD) * shares for way in ("yaw", "pitch")
        )
        for name, part in (("neck", 0.4), ("head", 0.6)):
            if name in joints:
                turns[:, joints.index(name), 1] += part * TURN_YAW * yaw
                turns[:, joints.index(name), 0] += part * TURN_PITCH * pitch
        return Overlay(joints, turns.astype(np.float32))

    def _shares(self, chunk: int, *, is_idle: bool) -> Path:
        begin = self._ends.get(chunk - 1, 1.0 if chunk == 0 else 0.0)
        pace = 1 / (RISE_S * FRAME_RATE_HZ) if is_idle else -1 / (FALL_S * FRAME_RATE_HZ)
        path = np.clip(begin + pace * np.arange(1, CHUNK_FRAMES + 1), 0, 1)
        self._ends[chunk] = float(path[-1])
        for old in [known for known in self._ends if known < chunk - KEPT]:
            del self._ends[old]
        return _eased(path)

    def _drawn(
        self, frames: np.ndarray, every_s: float, takes_s: float, what: str, still: float = 0.0
    ) -> Path:
        """From one place in -1..1 to another in each stretch of time, smoothly; `still` is the share that is 0."""
        every, takes = round(every_s * FRAME_RATE_HZ), takes_s * FRAME_RATE_HZ
        path = np.zeros(len(frames))
        for at, frame in enumerate(frames.tolist()):
            stretch, since = divmod(frame, every)
            old, new = self._place(stretch - 1, what, still), self._place(stretch, what, still)
            begins = self._number(stretch, f"{what} begins") * (every - takes)
            path[at] = old + (new - old) * float(_eased(np.clip((since - begins) / takes, 0, 1)))
        return path

    def _place(self, stretch: int, what: str, still: float) -> float:
        if stretch < 0 or self._number(stretch, f"{what} at all") < still:
            return 0.0
        return 2 * self._number(stretch, what) - 1

    def _number(self, stretch: int, what: str) -> float:
        """In 0..1, by seed, place and purpose alone."""
        word = hashlib.blake2b(f"{self._seed}:{what}:{stretch}".encode(), digest_size=4).digest()
        return int.from_bytes(word) / 2**32


def breath(frames: np.ndarray, seed: int = 0) -> Path:
    """How full the lungs are, 0 to 1: quickly in, slowly out."""
    place = (frames / (BREATH_S * FRAME_RATE_HZ) + seed % 11 / 11) % 1
    return np.where(place < INHALE, _eased(place / INHALE), 1 - _eased((place - INHALE) / (1 - INHALE)))


def shifted(motion: MotionChunk, metres: Float[np.ndarray, " t"], skeleton: Skeleton) -> MotionChunk:
    """The hips carried to the body's left over feet that stay."""
    rotations, root = motion.rotations.copy(), motion.root.copy()
    hips = np.moveaxis(rotations[:, skeleton.index("hips")], -1, 0)
    ahead = _rotated(hips, np.array([0, 0, 1], np.float32)) * np.array([[1], [0], [1]], np.float32)
    ahead = lanes.normalized(ahead)  # level
    moved = []
    for upper_name, lower_name, foot_name in _LEGS:
        upper, lower, foot = (skeleton.index(name) for name in (upper_name, lower_name, foot_name))
        thigh = lanes.multiply(hips, np.moveaxis(rotations[:, upper], -1, 0))
        shin = lanes.multiply(thigh, np.moveaxis(rotations[:, lower], -1, 0))
        sole = lanes.multiply(shin, np.moveaxis(rotations[:, foot], -1, 0))
        leg = _rotated(thigh, skeleton.offsets[lower].numpy()) + _rotated(
            shin, skeleton.offsets[foot].numpy()
        )
        roll = lanes.quaternion(-ahead * (metres / np.maximum(-leg[1], 0.1)))
        moved.append(leg - _rotated_by(roll, leg))
        rotations[:, upper] = _local(hips, lanes.multiply(roll, thigh))
        rotations[:, foot] = _local(lanes.multiply(roll, shin), sole)
    shift = (moved[0] + moved[1]) / 2
    root[:, 0] += shift[0]
    root[:, 2] += shift[2]
    return motion._replace(rotations=rotations, root=root)


def _local(parent: np.ndarray, world: np.ndarray) -> np.ndarray:
    """A world rotation as one relative to its parent's, lanes first again."""
    return np.moveaxis(lanes.normalized(lanes.multiply(lanes.conjugate(parent), world)), 0, -1)


def _rotated(rotation: Float[np.ndarray, "4 t"], vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 t"]:
    return _rotated_by(rotation, np.repeat(vector[:, None], rotation.shape[1], 1))


def _rotated_by(
    rotation: Float[np.ndarray, "4 t"], vectors: Float[np.ndarray, "3 t"]
) -> Float[np.ndarray, "3 t"]:
    pure = np.concatenate([np.zeros_like(vectors[:1]), vectors])
    return lanes.multiply(lanes.multiply(rotation, pure), lanes.conjugate(rotation))[1:]


def _eased(share: np.ndarray) -> np.ndarray:
    """0 to 1 without a step in speed or acceleration."""
    return np.asarray(share**3 * (10 - share * (15 - 6 * share)), np.float32)
