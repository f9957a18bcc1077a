"""How a body moves, as statistics of a window of motion: what gives a body away beside people. Not in the paper.

`liveliness` asks how much a body moves. This file asks how: how both hands share the work, where they are, how strokes
start, stop and hold, how trunk and head take part, and how tightly the hands follow the sound. All of it is measured at
30 frames a second, with wrists in the frame of the shoulders and in arm lengths. docs/metrics.md explains the rows.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.motion import resample
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME

from .liveliness import POINTS, Points, arm_length, body_points, hand_paths, in_shoulder_frame

JUDGED = (*POINTS, "neck")
MIRROR = np.array([-1.0, 1.0, 1.0])
WORKS, RESTS, HOLDS, STEPS = 0.5, 0.15, 0.25, 0.3  # speeds: arm lengths a second; of the ankle metres a second
SHORTEST_HOLD_S, SHARED_S = 0.2, 3
RAISED = -0.5  # arm lengths above the shoulders: about the elbow of a hanging arm
DIP, STROKE, ONE_HANDED = 0.1, 0.2, 0.4  # arm lengths a second, twice, and the other hand's share of the speed
SLOW_FRAMES = 1.5 * FRAME_RATE_HZ  # of the Gaussian whose mean is a slow change of place or loudness
PAUSE, FEWEST_QUIET, MOST_LATE = 0.1, 15, 30  # of the loudest frames; frames; frames


class Moves(NamedTuple):
    """A window of motion at 30 frames a second, as the statistics see it."""

    points: Points  # `JUDGED`, metres of a body of common height
    hands: Float[np.ndarray, "t 2 3"]  # left, right: arm lengths, X to the left, Y up, Z to the front
    velocity: Float[np.ndarray, "t 2 3"]
    speed: Float[np.ndarray, "t 2"]
    fast: Float[np.ndarray, " t"]  # the faster hand
    trunk: Float[np.ndarray, "t 3"]  # from between the hip joints to between the shoulders, metres
    trunk_speed: Float[np.ndarray, " t"]  # of the middle of the shoulders, m/s

    @classmethod
    def of(cls, points: Points) -> Self:
        """Measure points named `JUDGED` at 30 frames a second."""
        hands = hand_paths(points)
        velocity = _velocity(hands)
        speed = np.linalg.norm(velocity, axis=-1)
        shoulders, hips = (_between(points, bone) for bone in ("UpperArm", "UpperLeg"))
        trunk_speed = np.linalg.norm(_velocity(shoulders), axis=-1)
        trunk = in_shoulder_frame(points, shoulders - hips)
        return cls(points, hands, velocity, speed, speed.max(1), trunk, trunk_speed)


def judged_points(motion: Motion) -> Points:
    """World positions of `JUDGED` at 30 frames a second, scaled to a body of common height.

    Raises MotionError if the rig is not known, or the motion is shorter than a second.
    """
    if motion.seconds < 1:
        raise MotionError(f"{motion.seconds:.2f} s of motion cannot be judged; give at least 1 s")
    is_ours = abs(motion.fps - FRAME_RATE_HZ) < 1e-3
    return body_points(motion if is_ours else resample(motion, float(FRAME_RATE_HZ)), JUDGED)


def tells(
    points: Points, loud: Float[np.ndarray, " t"] | None = None, table: "Table | None" = None
) -> dict[str, float]:
    """The statistics of `table` (default: `TELLS`) of one window of `JUDGED`; of `HEARD` too, given its `loudness`."""
    moves = Moves.of(points)
    found = {name: float(measure(moves)) for name, measure in (table or TELLS).items()}
    if loud is not None:
        frames = min(len(loud), len(moves.fast))
        found |= {name: float(measure(loud[:frames], moves.fast[:frames])) for name, measure in HEARD.items()}
    return found


def loudness(audio: Float[np.ndarray, " s"]) -> Float[np.ndarray, " t"]:
    """Root mean square of each frame of a sound (24 kHz), of a peak of 1."""
    frames = audio[: len(audio) // SAMPLES_PER_FRAME * SAMPLES_PER_FRAME].reshape(-1, SAMPLES_PER_FRAME)
    return np.asarray(np.sqrt(np.square(frames, dtype=np.float64).mean(1)) / (np.abs(audio).max(initial=0) + 1e-9))


def _velocity(paths: Float[np.ndarray, "t *p 3"]) -> Float[np.ndarray, "t *p 3"]:
    """A second, along paths that are smoothed by a Gaussian of one frame."""
    return np.asarray(np.gradient(gaussian_filter1d(paths, 1, axis=0), axis=0) * FRAME_RATE_HZ)


def _at(points: Points, name: str) -> Float[np.ndarray, "t 3"]:
    return points[:, JUDGED.index(name)]


def _between(points: Points, bone: str) -> Float[np.ndarray, "t 3"]:
    return np.asarray((_at(points, "left" + bone) + _at(points, "right" + bone)) / 2)


def _together(some: Float[np.ndarray, " t"], others: Float[np.ndarray, " t"]) -> float:
    """Correlation; 0 where one of the two does not change."""
    return float(np.corrcoef(some, others)[0, 1]) if min(some.std(), others.std()) > 1e-9 else 0.0


def _mirrored_velocity(moves: Moves) -> float:
    left, right = moves.velocity[:, 0], moves.velocity[:, 1]
    return float((left * right * MIRROR).sum() / (np.linalg.norm(left) * np.linalg.norm(right) + 1e-9))


def _unequal(speed: Float[np.ndarray, "t 2"]) -> float:
    left, right = speed.mean(0)
    return float(abs(left - right) / (left + right + 1e-9))


def _unequal_within(moves: Moves) -> float:
    size = SHARED_S * FRAME_RATE_HZ
    starts = range(0, max(len(moves.speed) - size, 0) + 1, size)
    return float(np.mean([_unequal(moves.speed[at : at + size]) for at in starts]))


def _one_handed(moves: Moves) -> float:
    """Share of strokes in which one hand has less than `ONE_HANDED` of the other's speed.

    A stroke lasts from one dip of the faster hand's speed to the next.
    """
    dips = [0, *find_peaks(-moves.fast, prominence=DIP)[0], len(moves.fast)]
    strokes = [moves.speed[start:end].mean(0) for start, end in pairwise(dips) if moves.fast[start:end].max() > STROKE]
    return float(np.mean([own.min() < ONE_HANDED * own.max() for own in strokes])) if strokes else float("nan")


def _elbow_angle(moves: Moves) -> float:
    angles = []
    for side in ("left", "right"):
        shoulder, elbow, wrist = (_at(moves.points, side + bone) for bone in ("UpperArm", "LowerArm", "Hand"))
        angles.append(_angle(shoulder - elbow, wrist - elbow))
    return float(np.degrees(np.mean(angles)))


def _angle(some: Float[np.ndarray, "t 3"], others: Float[np.ndarray, "#t 3"]) -> Float[np.ndarray, " t"]:
    lengths = np.linalg.norm(some, axis=-1) * np.linalg.norm(others, axis=-1) + 1e-9
    return np.asarray(np.arccos(((some * others).sum(-1) / lengths).clip(-1, 1)))


def _stretches_s(holds: Bool[np.ndarray, " t"]) -> Float[np.ndarray, " n"]:
    """Lengths of the stretches in which this holds, seconds; shorter ones than `SHORTEST_HOLD_S` are left out."""
    ends = np.flatnonzero(np.diff(np.pad(holds, 1).astype(int)))
    lengths = (ends[1::2] - ends[::2]) / FRAME_RATE_HZ
    return np.asarray(lengths[lengths >= SHORTEST_HOLD_S])


def _holds_s(moves: Moves) -> Float[np.ndarray, " n"]:
    """Lengths of the stretches in which both hands are slower than `HOLDS`, seconds."""
    return _stretches_s(moves.fast < HOLDS)


def _stays_up_s(moves: Moves) -> float:
    """Median time for which a raised hand stays up, seconds; NaN where none is raised."""
    times = np.concatenate([_stretches_s(moves.hands[:, side, 1] > RAISED) for side in range(2)])
    return float(np.median(times)) if len(times) else float("nan")


def _starts_over_stops(moves: Moves) -> float:
    low, high = np.quantile(np.gradient(moves.fast), (0.05, 0.95))
    return float(high / -low) if low < 0 else float("nan")


def _power(moves: Moves) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """Frequencies (0.2 to 8 Hz) of the hands' paths, slow changes of place left out, and the share of each."""
    moved = moves.hands - gaussian_filter1d(moves.hands, SLOW_FRAMES, axis=0)
    spectrum = (np.abs(np.fft.rfft(moved * np.hanning(len(moved))[:, None, None], axis=0)) ** 2).sum((1, 2))
    hertz = np.fft.rfftfreq(len(moved), 1 / FRAME_RATE_HZ)
    is_in = (hertz > 0.2) & (hertz < 8)
    return hertz[is_in], spectrum[is_in] / (spectrum[is_in].sum() + 1e-12)


def _lean(moves: Moves, axis: int) -> float:
    """Deviation of the trunk's lean along an axis of the shoulders' frame, degrees."""
    return float(np.degrees(np.arctan2(moves.trunk[:, axis], moves.trunk[:, 1])).std())


def _head_deg(moves: Moves) -> float:
    head = in_shoulder_frame(moves.points, _at(moves.points, "head") - _at(moves.points, "neck"))
    head = head / (np.linalg.norm(head, axis=-1, keepdims=True) + 1e-9)
    return float(np.degrees(_angle(head, head.mean(0, keepdims=True)).std()))


def _steps(moves: Moves) -> float:
    ankles = [np.linalg.norm(_velocity(_at(moves.points, side + "Foot")), axis=-1) for side in ("left", "right")]
    return float((np.maximum(*ankles) > STEPS).mean())


Table = Mapping[str, Callable[[Moves], Any]]
TELLS: Table = {
    "hands: heights together": lambda m: _together(m.hands[:, 0, 1], m.hands[:, 1, 1]),
    "hands: speeds together": lambda m: _together(m.speed[:, 0], m.speed[:, 1]),
    "hands: mirrored velocity": _mirrored_velocity,
    "hands: apart from mirror image": lambda m: np.linalg.norm(m.hands[:, 0] - m.hands[:, 1] * MIRROR, axis=-1).mean(),
    "hands: one works, other rests": lambda m: ((m.fast > WORKS) & (m.speed.min(1) < RESTS)).mean(),
    "hands: unequal share of work": lambda m: _unequal(m.speed),
    "hands: unequal within 3 s": _unequal_within,
    "hands: one-handed strokes": _one_handed,
    "hands: stay up, median s": _stays_up_s,
    "place: mean height": lambda m: m.hands[..., 1].mean(),
    "place: height, 90 %": lambda m: np.quantile(m.hands[..., 1], 0.9),
    "place: above shoulders, share": lambda m: (m.hands[..., 1] > 0).mean(),
    "place: to the front": lambda m: m.hands[..., 2].mean(),
    "place: to the side": lambda m: (m.hands[:, 0, 0] - m.hands[:, 1, 0]).mean() / 2,
    "place: elbow angle, deg": _elbow_angle,
    "stroke: speed, 50 %": lambda m: np.median(m.fast),
    "stroke: speed, 95 %": lambda m: np.quantile(m.fast, 0.95),
    "stroke: peak over mean": lambda m: np.quantile(m.fast, 0.95) / (m.fast.mean() + 1e-9),
    "stroke: starts over stops": _starts_over_stops,
    "stroke: mean frequency, Hz": lambda m: np.multiply(*_power(m)).sum(),
    "stroke: share above 3 Hz": lambda m: _power(m)[1][_power(m)[0] > 3].sum(),
    "hold: a minute": lambda m: len(_holds_s(m)) * 60 * FRAME_RATE_HZ / len(m.fast),
    "hold: mean length, s": lambda m: np.append(_holds_s(m), 0).sum() / max(len(_holds_s(m)), 1),
    "trunk: sideways, sd deg": lambda m: _lean(m, 0),
    "trunk: forwards, sd deg": lambda m: _lean(m, 2),
    "trunk: sideways over forwards": lambda m: _lean(m, 0) / (_lean(m, 2) + 1e-9),
    "trunk: moves with hands": lambda m: _together(*(gaussian_filter1d(x, 5) for x in (m.trunk_speed, m.fast))),
    "trunk: speed over hands'": lambda m: m.trunk_speed.mean() / (m.fast.mean() * arm_length(m.points) + 1e-9),
    "head: against shoulders, sd deg": _head_deg,
    "hips: travel, m/s": lambda m: np.linalg.norm(_velocity(_at(m.points, "hips"))[:, ::2], axis=-1).mean(),
    "feet: time in which one steps": _steps,
}
"""Each statistic; distances are in arm lengths and speeds in arm lengths a second, unless the name says otherwise."""

SHARING: Table = {
    name: TELLS[name]
    for name in (
        *("hands: one-handed strokes", *list(TELLS)[:3], "hands: unequal within 3 s", "hold: a minute"),
        "trunk: moves with hands",
    )
}
"""Statistics that say at which stage between a corpus and the screen hands lose what people do (`evaluation.codes`)."""


def _lags(loud: Float[np.ndarray, " t"], fast: Float[np.ndarray, " t"]) -> dict[int, float]:
    """Correlation of loudness and speed where the hands are up to a second late (or early), by frames."""
    heard, moved = (gaussian_filter1d(x, 2) - gaussian_filter1d(x, SLOW_FRAMES) for x in (np.log(loud + 1e-3), fast))
    late = range(-min(MOST_LATE, len(fast) // 2), min(MOST_LATE, len(fast) // 2) + 1)
    ends = {lag: (len(fast) - max(0, lag), len(fast) - max(0, -lag)) for lag in late}
    return {lag: _together(heard[max(0, -lag) : a], moved[max(0, lag) : b]) for lag, (a, b) in ends.items()}


def _in_pauses(loud: Float[np.ndarray, " t"], fast: Float[np.ndarray, " t"]) -> float:
    is_quiet = gaussian_filter1d(loud, 3) < PAUSE * np.quantile(loud, 0.95)
    return float(fast[is_quiet].mean() / (fast.mean() + 1e-9)) if is_quiet.sum() > FEWEST_QUIET else float("nan")


HEARD: Mapping[str, Callable[[np.ndarray, np.ndarray], float]] = {
    "sound: loudness and speed, same time": lambda loud, fast: _lags(loud, fast)[0],
    "sound: loudness and speed, best lag": lambda loud, fast: max(_lags(loud, fast).values()),
    "sound: in pauses, speed over mean": _in_pauses,
}
