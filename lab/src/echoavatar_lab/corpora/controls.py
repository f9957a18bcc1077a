"""Choreography controls: the curves that gesture, dance and idle motion are written in. Not in the paper.

A performance is a table of low-dimensional, blendable curves at 30 fps; `solver.solve` turns it into joint rotations.
Conventions (metres and radians, Y up, facing +Z, left at +X):

* yaw > 0 turns left, pitch > 0 bows forward, roll > 0 leans right; a triple means Ry(yaw) Rx(pitch) Rz(roll);
* axis 1 of a paired array is (left, right); feet live in world axes, arms in mirrored chest axes (+x outwards);
* palm: flex > 0 towards the palm, deviation > 0 towards the thumb, pronation > 0 palm down (0 = handshake);
* a flat foot has its ankle at `ANKLE_HEIGHT`; `foot_pitch` > 0 lifts the heel about the ball, < 0 the toes;
  `foot_roll` > 0 turns the sole outwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from echoavatar.motion.kinematics.easing import smootherstep
from echoavatar.timing import FRAME_RATE_HZ

Array = np.ndarray

ANKLE_HEIGHT = 0.085
BALL_M = 0.13  # from the ankle to the ball of the foot
STANDING_PELVIS = (0.0, 0.944, 0.0)
STANDING_FEET = ((0.105, ANKLE_HEIGHT, -0.015), (-0.105, ANKLE_HEIGHT, -0.015))
STANDING_FOOT_YAW = (0.14, -0.14)
HANGING_WRIST = (0.110, -0.485, 0.050)
FOLDED_M = 0.12  # from the shoulder to the wrist at least: a folded arm
DRIFT_FRAMES = 8  # over which the speed of an arm fades at a join
RELAXED_FINGERS = (0.25, 0.20, 0.24, 0.28, 0.30, 0.05, 0.25)
FEET = ("foot_position", "foot_yaw", "foot_pitch", "foot_roll")
_PAIRED = (*FEET, "knee_swing", "shoulder", "wrist", "palm", "elbow_swing", "fingers")
_WHOLE_TURNS = ("pelvis_rotation", "foot_yaw", "elbow_swing", "knee_swing")  # these angles may wind; others have limits


@dataclass(frozen=True)
class Controls:
    """Curves of one performance, frames first; the module docstring defines signs and axes."""

    pelvis_position: Float[Array, "t 3"]
    pelvis_rotation: Float[Array, "t 3"]  # yaw, pitch, roll
    spine: Float[Array, "t 3"]  # chest relative to pelvis: yaw, pitch, roll
    head: Float[Array, "t 3"]  # head relative to chest: yaw, pitch, roll
    foot_position: Float[Array, "t 2 3"]  # ankle of the flat foot, world
    foot_yaw: Float[Array, "t 2"]  # world
    foot_pitch: Float[Array, "t 2"]
    shoulder: Float[Array, "t 2 2"]  # clavicle lift, forward
    wrist: Float[Array, "t 2 3"]  # from the shoulder joint, mirrored chest axes
    palm: Float[Array, "t 2 3"]  # flex, deviation, pronation
    elbow_swing: Float[Array, "t 2"]  # > 0 lifts the elbow outwards
    fingers: Float[Array, "t 2 7"]  # curl thumb, index, middle, ring, little 0..1; spread -1..1; opposition 0..1
    foot_roll: Float[Array, "t 2"]
    knee_swing: Float[Array, "t 2"]  # about the line from hip to ankle, > 0 outwards

    def __len__(self) -> int:
        return len(self.pelvis_position)

    def __getitem__(self, frames: slice | NDArray[np.intp]) -> Self:
        return replace(self, **{field.name: getattr(self, field.name)[frames] for field in fields(self)})

    def packed(self) -> Float[Array, "t c"]:
        """All curves side by side, in field order."""
        return np.concatenate([getattr(self, f.name).reshape(len(self), -1) for f in fields(self)], axis=1)

    def hands(self) -> Float[Array, "t 2 14"]:
        """Wrist, palm, swing of the elbow and fingers of both hands."""
        return np.concatenate([self.wrist, self.palm, self.elbow_swing[..., None], self.fingers], axis=-1)

    @classmethod
    def unpacked(cls, table: Float[Array, "t c"]) -> Self:
        """Inverse of `packed`."""
        like = neutral(1)
        parts: dict[str, Array] = {}
        start = 0
        for field in fields(cls):
            shape = getattr(like, field.name).shape[1:]
            width = int(np.prod(shape))
            columns = table[:, start : start + width].astype(np.float32)
            parts[field.name] = columns.reshape(len(table), *shape)
            start += width
        return cls(**parts)


def neutral(frames: int) -> Controls:
    """Standing at ease: arms hanging a little off the body, fingers slightly bent, toes slightly out."""

    def still(value: Sequence[float] | Sequence[Sequence[float]]) -> Array:
        one = np.asarray(value, np.float32)
        return np.broadcast_to(one, (frames, *one.shape)).copy()

    return Controls(
        pelvis_position=still(STANDING_PELVIS),
        pelvis_rotation=still((0.0, 0.0, 0.0)),
        spine=still((0.0, 0.02, 0.0)),
        head=still((0.0, 0.02, 0.0)),
        foot_position=still(STANDING_FEET),
        foot_yaw=still(STANDING_FOOT_YAW),
        foot_pitch=still((0.0, 0.0)),
        shoulder=still(((0.0, 0.0), (0.0, 0.0))),
        wrist=still((HANGING_WRIST, HANGING_WRIST)),
        palm=still(((0.08, 0.0, 0.35), (0.08, 0.0, 0.35))),
        elbow_swing=still((0.0, 0.0)),
        fingers=still((RELAXED_FINGERS, RELAXED_FINGERS)),
        foot_roll=still((0.0, 0.0)),
        knee_swing=still((0.0, 0.0)),
    )


def concatenated(parts: Sequence[Controls]) -> Controls:
    """Performances one after another."""
    return Controls.unpacked(np.concatenate([part.packed() for part in parts]))


def blended(start: Controls, end: Controls, weight: Float[Array, " t"]) -> Controls:
    """Mix linearly per frame: weight 0 gives `start`, 1 gives `end`.

    Planted feet slide unless both sides have them in the same place.
    """
    share = np.asarray(weight, np.float32)[:, None]
    first, second = start.packed(), end.packed()
    return Controls.unpacked(first + (second - first) * share)


def mirrored(controls: Controls) -> Controls:
    """The same performance, left and right exchanged."""
    across, around = np.array([-1, 1, 1], np.float32), np.array([-1, 1, -1], np.float32)
    sides = {name: getattr(controls, name)[:, ::-1].copy() for name in _PAIRED}
    sides |= {"foot_position": sides["foot_position"] * across, "foot_yaw": -sides["foot_yaw"]}
    return Controls(
        pelvis_position=controls.pelvis_position * across,
        pelvis_rotation=controls.pelvis_rotation * around,
        spine=controls.spine * around,
        head=controls.head * around,
        **sides,
    )


def moved(controls: Controls, shift: Float[np.ndarray, " 2"], *, turn: float = 0.0) -> Controls:
    """The same performance turned to the left about the vertical through the origin, then shifted in x and z."""
    along = np.array([shift[0], 0.0, shift[1]], np.float32)
    return replace(
        controls,
        pelvis_position=np.asarray(turned(controls.pelvis_position, turn) + along, np.float32),
        pelvis_rotation=controls.pelvis_rotation + np.array([turn, 0.0, 0.0], np.float32),
        foot_position=np.asarray(turned(controls.foot_position, turn) + along, np.float32),
        foot_yaw=controls.foot_yaw + np.float32(turn),
    )


def unwound(controls: Controls, like: Controls, at: int, like_at: int) -> Controls:
    """The same performance with angles shifted by whole turns: at frame `at` they are next to `like`'s at `like_at`."""
    curves = {}
    for name in _WHOLE_TURNS:
        old, new = getattr(like, name)[like_at], getattr(controls, name)
        curves[name] = np.asarray(new + 2 * np.pi * np.round((old - new[at]) / (2 * np.pi)), np.float32)
    return replace(controls, **curves)


def facing(controls: Controls) -> float:
    """The mean heading of the hips, radians."""
    yaw = controls.pelvis_rotation[:, 0]
    return float(np.arctan2(np.sin(yaw).mean(), np.cos(yaw).mean()))


def turned(way: Float[np.ndarray, "*n d"], angle: Float[np.ndarray, "*#n"] | float) -> Float[Array, "*n d"]:
    """Ways over the floor, (x, z) or (x, y, z), turned to the left by angles in radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, z = way[..., 0], way[..., -1]
    height = [way[..., 1]] if way.shape[-1] == 3 else []
    return np.stack([cos * x + sin * z, *height, cos * z - sin * x], -1)


def at_most(way: Float[np.ndarray, " 2"], length: float) -> Float[Array, " 2"]:
    """A way over the floor, cut to a length."""
    return np.asarray(way * min(1.0, length / max(float(np.hypot(*way)), 1e-6)))


def spans_of(mask: Bool[np.ndarray, " t"]) -> list[tuple[int, int]]:
    """First frames and ends of the stretches in which a mask is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def gap(old: Float[np.ndarray, "t ..."], new: Float[np.ndarray, "n ..."]) -> tuple[Array, Array]:
    """Difference of place, and of speed per frame, between a curve that ends and the one that follows it."""
    speed = old[-1] - old[-2]
    return old[-1] + speed - new[0], speed - (new[1] - new[0])


def fading(
    place: Float[np.ndarray, "..."],
    speed: Float[np.ndarray, "..."],
    frames: int,
    length: int,
    *,
    drift: int | None = None,
) -> Float[Array, "t ..."]:
    """A difference of poses, and of speeds per frame, that fades out along a quintic (inertialisation).

    It is gone after `frames` of the `length` frames. With `drift` the speeds fade within so many frames: the longer
    they take, the further they carry away.
    """

    def phase(end: int) -> Array:
        ratio = np.minimum(np.arange(length) / end, 1.0)
        return np.asarray(ratio.reshape(-1, *([1] * np.ndim(place))))

    drift = frames if drift is None else min(drift, frames)
    p, q = phase(frames), phase(drift)
    stay = 1 - minimum_jerk(p)
    return np.asarray(stay * place + (q - q**3 * (6 - 8 * q + 3 * q**2)) * drift * speed, np.float32)


def wrists_over(old: Float[Array, "2 2 3"], new: Float[Array, "n 2 3"], frames: int) -> Float[Array, "m 2 3"]:
    """`new` without its first frame, begun where `old` ends; both begin in the frame before the join.

    The difference fades as a turn about the shoulder and as a length: along a straight line the hand would pass
    through the shoulder, and the arm would flip.
    """
    stay = fading(np.ones(1), np.zeros(1), frames, len(new) - 1)
    drift = fading(np.zeros(1), np.ones(1), frames, len(new) - 1, drift=DRIFT_FRAMES)
    over = np.zeros((len(new) - 1, 2, 3), np.float32)
    for side in range(2):
        was, now = old[:, side], new[:, side]
        turn = _turn_between(now[1], was[1])
        speed = _turn_between(*was) - Rotation.from_rotvec(turn).apply(_turn_between(*now[:2]))
        far = np.linalg.norm(was, axis=-1) - np.linalg.norm(now[:2], axis=-1)
        length = np.linalg.norm(now[1:], axis=-1, keepdims=True)
        aim = (Rotation.from_rotvec(drift * speed) * Rotation.from_rotvec(stay * turn)).apply(now[1:] / length)
        over[:, side] = aim * np.maximum(length + stay * far[1] + drift * (far[1] - far[0]), FOLDED_M)
    return over


def _turn_between(start: Float[Array, " 3"], end: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The smallest turn of one direction to another, as a rotation vector."""
    axis = np.cross(start, end)
    return np.asarray(axis / max(float(np.linalg.norm(axis)), 1e-9) * np.arctan2(np.linalg.norm(axis), start @ end))


def air(phase: Float[np.ndarray, " t"]) -> Float[Array, " t"]:
    """Height of a step over its phase: 0 at lift-off and landing, 1 half-way, smooth at both ends."""
    p = np.clip(phase, 0.0, 1.0)
    return np.asarray(64 * (p * (1 - p)) ** 3, np.float32)


def minimum_jerk(phase: Float[np.ndarray, "*n"]) -> Float[Array, "*n"]:
    """Minimum-jerk progress: 0 before phase 0, 1 after phase 1, no velocity or acceleration at the ends."""
    return np.asarray(smootherstep(np.clip(phase, 0.0, 1.0)), np.float32)


def critically_damped(signal: Float[Array, "t ..."], seconds: float) -> Float[Array, "t ..."]:
    """Causal smoothing by a critically damped spring that covers most of a step in `seconds`."""
    keep = float(np.exp(-4.0 / (FRAME_RATE_HZ * seconds)))
    first = np.asarray(signal[:1], np.float64)
    moved = lfilter([(1 - keep) ** 2], [1.0, -2 * keep, keep * keep], signal - first, axis=0)
    return np.asarray(moved + first, np.float32)


def smoothed(signal: Float[Array, "t ..."], seconds: float) -> Float[Array, "t ..."]:
    """Gaussian smoothing with a standard deviation in seconds; the end values are repeated beyond the ends."""
    return np.asarray(gaussian_filter1d(signal, seconds * FRAME_RATE_HZ, axis=0, mode="nearest"), np.float32)


def wander(frames: int, channels: int, *, period: float, rng: np.random.Generator) -> Float[Array, "t c"]:
    """Slow random drift of unit deviation: white noise smoothed to the given period in seconds."""
    sigma = period * FRAME_RATE_HZ / 5
    margin = int(4 * sigma) + 1
    noise = gaussian_filter1d(rng.standard_normal((frames + 2 * margin, channels)), sigma, axis=0)
    return np.asarray(noise[margin : margin + frames] * np.sqrt(2 * np.sqrt(np.pi) * sigma), np.float32)
