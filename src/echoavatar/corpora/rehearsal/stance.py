"""Standing: feet that take small steps, and the weight that shifts between them.

A foot's position is constant except during its own step.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ

from .controls import ANKLE_HEIGHT, STANDING_FEET, STANDING_FOOT_YAW, Array, minimum_jerk, through_keys


@dataclass(frozen=True)
class Step:
    """One foot lifts off at `begin` and lands at `end` (seconds) at a new position (x, z metres) and yaw (radians)."""

    begin: float
    end: float
    side: int
    x: float
    z: float
    yaw: float
    lift: float = 0.045


@dataclass(frozen=True)
class Feet:
    """Foot curves as in `Controls`."""

    position: Float[Array, "t 2 3"]
    yaw: Float[Array, "t 2"]
    pitch: Float[Array, "t 2"]


def walked(frames: int, steps: Sequence[Step]) -> Feet:
    """Feet that stand at ease and take the given steps, in order of time."""
    position = np.broadcast_to(np.array(STANDING_FEET, np.float32), (frames, 2, 3)).copy()
    yaw = np.broadcast_to(np.array(STANDING_FOOT_YAW, np.float32), (frames, 2)).copy()
    pitch = np.zeros((frames, 2), np.float32)
    clock = np.arange(frames) / FRAME_RATE_HZ
    for step in steps:
        first = min(max(int(np.floor(step.begin * FRAME_RATE_HZ)), 0), frames)
        phase = (clock[first:] - step.begin) / (step.end - step.begin)
        share, side = minimum_jerk(phase), step.side
        goal = np.array([step.x, ANKLE_HEIGHT, step.z], np.float32)
        position[first:, side] += (goal - position[first:, side]) * share[:, None]
        position[first:, side, 1] += step.lift * air(phase)
        yaw[first:, side] += (step.yaw - yaw[first:, side]) * share
        pitch[first:, side] += 7.0 * step.lift * air(np.clip(phase, 0, 0.7) / 0.7)
    return Feet(position, yaw, pitch)


def air(phase: Float[np.ndarray, " t"]) -> Float[Array, " t"]:
    """Height of a step over its phase: 0 at lift-off and landing, 1 half-way, smooth at both ends."""
    p = np.clip(phase, 0.0, 1.0)
    return np.asarray(64 * (p * (1 - p)) ** 3, np.float32)


@dataclass(frozen=True)
class Shift:
    """A move of the weight to one leg: `weight` is -1 right, 0 middle, +1 left, reached at `end`."""

    begin: float
    end: float
    weight: float


def weight_curve(frames: int, shifts: Sequence[Shift], start: float) -> Float[Array, " t"]:
    """The weight over time; each shift is a minimum-jerk move."""
    times, values, last = [0.0], [start], start
    for shift in shifts:
        if shift.begin <= times[-1]:
            continue
        times += [shift.begin, shift.end]
        values += [last, shift.weight]
        last = shift.weight
    return through_keys(np.array(times), np.array(values, np.float32), frames)


def weight_shifts(
    seconds: float, cues: Sequence[float], rng: np.random.Generator, *, pace: float, step_every: float
) -> tuple[list[Step], list[Shift]]:
    """Draw weight shifts and occasional small steps; each starts at a near cue (seconds), if there is one.

    `pace` is the mean time between shifts, `step_every` between steps. A stepping foot carries no weight.
    """
    steps: list[Step] = []
    shifts: list[Shift] = []
    weight, time = float(rng.choice([-0.6, 0.6])), float(rng.uniform(0.5, pace))
    next_step = float(rng.uniform(0.4, 1.4) * step_every)
    while time < seconds - 3.0:
        near = [cue for cue in cues if time - 1.0 < cue < time + 3.0]
        time = max(near[0], time - 1.0) if near else time
        if time > next_step and abs(weight) > 0.3:
            begin = time + 0.15
            steps.append(_small_step(begin, side=1 if weight > 0 else 0, rng=rng))
            shifts.append(Shift(time, time + 0.45, float(np.sign(weight))))
            time, next_step = begin + 0.55, time + float(rng.uniform(0.6, 1.5) * step_every)
        weight = float(rng.choice([-1, 1]) * rng.uniform(0.4, 1.0)) if rng.random() < 0.25 else -weight
        weight = float(np.clip(weight * rng.uniform(0.8, 1.2), -1, 1))
        length = float(rng.uniform(0.8, 1.5))
        shifts.append(Shift(time, time + length, weight))
        time += length + float(rng.gamma(4.0, pace / 4.0))
    return steps, shifts


def _small_step(begin: float, *, side: int, rng: np.random.Generator) -> Step:
    """A step to within a few centimetres of the foot's neutral position."""
    x, _, z = STANDING_FEET[side]
    outwards = 1 if side == 0 else -1
    dx, dz = rng.uniform(-0.01, 0.05), rng.uniform(-0.05, 0.07)
    yaw = STANDING_FOOT_YAW[side] + outwards * rng.uniform(-0.08, 0.16)
    return Step(begin, begin + rng.uniform(0.42, 0.52), side, x + outwards * dx, z + dz, yaw)
