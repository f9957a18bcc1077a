"""Standing: feet that take small steps, and the weight that shifts between them.

A foot's position is constant except during its own step.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from echoavatar.models.generator.manner import Manner
from echoavatar.timing import FRAME_RATE_HZ

from ..controls import ANKLE_HEIGHT, STANDING_FEET, STANDING_FOOT_YAW, Array, Controls, air, minimum_jerk, neutral
from ..keyframes import glide
from .speakers import energy_of

LONGEST_STEP_M = 0.24  # to each side; longer ones stretch the leg behind
SHIFT_S, STANCE_S = 2.5, 2.3  # mean time between shifts of the weight, and between stances, of a person in conversation
ROAM_M = 0.14  # deviation of stances from the middle


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


def walked(frames: int, steps: Sequence[Step]) -> Controls:
    """A body at ease whose feet take the given steps, in order of time."""
    body = neutral(frames)
    position, yaw, pitch = body.foot_position, body.foot_yaw, body.foot_pitch
    clock = np.arange(frames) / FRAME_RATE_HZ
    for step in steps:
        first = min(max(int(np.floor(step.begin * FRAME_RATE_HZ)), 0), frames)
        phase = (clock[first:] - step.begin) / (step.end - step.begin)
        share, side = minimum_jerk((phase - 0.06) / 0.88), step.side  # a foot is off the floor before it travels
        goal = np.array([step.x, ANKLE_HEIGHT, step.z], np.float32)
        position[first:, side] += (goal - position[first:, side]) * share[:, None]
        position[first:, side, 1] += step.lift * air(phase)
        yaw[first:, side] += (step.yaw - yaw[first:, side]) * share
        pitch[first:, side] += 7.0 * step.lift * air(np.clip(phase, 0, 0.7) / 0.7)
    return body


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
    return glide(np.arange(frames) / FRAME_RATE_HZ, np.array(times), np.array(values, np.float32))


def stances(
    seconds: float, phrases: Sequence[tuple[float, float]], rng: np.random.Generator, manner: Manner, weight: float
) -> tuple[list[Step], list[Shift]]:
    """Draw shifts of the weight and new stances; each starts with a phrase, if one begins soon.

    In pauses both become rare. A stepping foot carries no weight. `weight` is that of the start.
    """
    shift_s, stance_s, roam = SHIFT_S / energy_of(manner), STANCE_S / energy_of(manner), ROAM_M * energy_of(manner)
    steps: list[Step] = []
    shifts: list[Shift] = []
    middle = np.zeros(2)
    time, next_stance = float(rng.uniform(0.5, shift_s)), float(rng.uniform(0.3, 1) * stance_s)
    while time < seconds - 3.0:
        is_quiet = not any(begin - 0.5 < time < end for begin, end in phrases)
        near = [begin for begin, _ in phrases if time - 0.3 < begin < time + 1.0]
        time = max(near[0], time) if near else time
        if time > next_stance and (not is_quiet or rng.random() < 0.15):
            time, weight, middle = _new_stance(time, middle, roam, rng, steps, shifts)
            next_stance = time + float(rng.uniform(0.5, 1.5) * stance_s)
        else:
            weight = float(np.clip(-np.sign(weight) * rng.uniform(0.4, 1.0), -1, 1)) if rng.random() < 0.8 else -weight
            length = float(rng.uniform(0.6, 1.2))
            shifts.append(Shift(time, time + length, weight))
            time += length
        time += float(rng.gamma(3.0, shift_s * (2.5 if is_quiet else 1.0) / 3.0))
    return steps, shifts


def _new_stance(
    time: float, middle: Array, roam: float, rng: np.random.Generator, steps: list[Step], shifts: list[Shift]
) -> tuple[float, float, Array]:
    """Step to a new place, first with the foot on the side of the way; return time, weight and place after it."""
    goal = np.clip(rng.normal(0, roam, 2), -2.5 * roam, 2.5 * roam)
    x, z = place = middle + np.clip(goal - middle, -LONGEST_STEP_M, LONGEST_STEP_M)
    heading, half = float(np.clip(rng.normal(0, 0.16), -0.4, 0.4)), float(rng.uniform(0.085, 0.165))
    stagger = float(rng.normal(0, 0.045))
    first = 0 if x > middle[0] else 1
    for turn, side in enumerate((first, 1 - first)):
        outwards = 1 if side == 0 else -1
        across, ahead = outwards * half, outwards * stagger
        length = float(rng.uniform(0.38, 0.50))
        shifts.append(Shift(time, time + 0.30, float(-outwards) * 0.95))
        time += 0.22
        steps.append(
            Step(
                begin=time,
                end=time + length,
                side=side,
                x=float(x + across * np.cos(heading) + ahead * np.sin(heading)),
                z=float(z - across * np.sin(heading) + ahead * np.cos(heading) + STANDING_FEET[0][2]),
                yaw=heading + outwards * (abs(STANDING_FOOT_YAW[0]) + float(rng.uniform(-0.06, 0.12))),
            )
        )
        time += length + (float(rng.uniform(0.0, 0.35)) if turn == 0 else 0.0)
    weight = float(rng.uniform(-1, 1))
    shifts.append(Shift(time, time + 0.6, weight))
    return time + 0.6, weight, place
