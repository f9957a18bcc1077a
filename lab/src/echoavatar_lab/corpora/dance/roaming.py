"""Travel laid over a dance: from side to side with the phrases, about the middle, by the steps that the dance has.

Each foot takes its share of the way while it is in the air, and the hips follow the feet; so planted feet stay where
they are, and a dance without steps does not travel.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.timing import FRAME_RATE_HZ

from ..controls import ANKLE_HEIGHT, BALL_M, Array, Controls, at_most, minimum_jerk, smoothed, spans_of, turned
from ..keyframes import glide
from .grooves import Counts

ASIDE_BY_RULE_M = 0.5, 1.0  # from the middle to the side
ASIDE_CAPTURED_M = 0.25, 0.7  # captured dancers travel of their own
FRONT_M, EDGE_M = 0.2, 1.0  # to the front or back, and at most
VARIED = 0.15  # share by which ways to the side differ within a dance
QUIET = 0.75  # share of it in the quietest music
LEG_S = 2.2  # from side to side at least
FASTEST_M_S = 1.1  # of the travel that is laid over, on average between two sides
OWN_S = 0.4  # over which the dance's own travel is smoothed
OUT_S = 0.8
STILL_M_S, LOW_M = 0.06, 0.03  # a low foot whose ball is slower than this stands
SWING_M_S = 3.4  # that a step may be faster than before, on average
APART_M = 0.38  # that one foot may be ahead of the other
CLOSEST_M = 0.13  # between the ankles, sideways, unless the dance itself brings them nearer
WIDEST_M = 0.58  # between the ankles, unless the dance itself sets them wider
LIFT_M = 0.06  # of a foot that is carried 20 cm or more
HIPS_S = 0.12  # by which the hips' way is smoother than the feet's


def with_travel(
    dance: Controls, counts: Counts, home: Controls, rng: np.random.Generator, aside_m: tuple[float, float]
) -> Controls:
    """The same dance with travel in one music span, about where `home` stands when it begins.

    What the dance travels itself is part of the way. `aside_m`, the least and most to the side, is `ASIDE_BY_RULE_M` or
    `ASIDE_CAPTURED_M`.
    """
    first, last = counts.frames(OUT_S, len(dance))
    if last - first < 2 * FRAME_RATE_HZ:
        return dance
    own = dance[first:last]
    feet, lift = _stepped(own, _wanted(own, first, counts, home, rng, aside_m))
    hips = smoothed(feet.mean(1), HIPS_S)
    place, foot = dance.pelvis_position.copy(), dance.foot_position.copy()
    place[first:last, ::2] += hips
    foot[first:last, :, ::2] += feet
    foot[first:last, :, 1] = np.maximum(foot[first:last, :, 1], ANKLE_HEIGHT + lift)
    place[last:, ::2] += hips[-1]
    foot[last:, :, ::2] += feet[-1]
    return replace(dance, pelvis_position=place, foot_position=foot)


def _wanted(
    own: Controls, first: int, counts: Counts, home: Controls, rng: np.random.Generator, aside_m: tuple[float, float]
) -> Float[Array, "t 2"]:
    """Shift in x and z, frame by frame, by which the dance would be at one side and the other in turns."""
    clock = (first + np.arange(len(own))) / FRAME_RATE_HZ
    path = smoothed(own.pelvis_position[:, ::2] - home.pelvis_position[first, ::2], OWN_S)
    apart = counts.apart(LEG_S, 3 if counts.metre == 3 else 4)
    heading, sign, wide = float(home.pelvis_rotation[first, 0]), rng.choice((-1, 1)), rng.uniform(*aside_m)
    times, shifts = [float(clock[0])], [np.zeros(2)]
    for count in range(apart, len(counts.times), apart):
        sign = -sign
        side, front = sign * wide * rng.uniform(1 - VARIED, 1 + VARIED), rng.uniform(-1, 1) * FRONT_M
        goal = turned((QUIET + (1 - QUIET) * counts.energy(count)) * np.array([side, front]), heading)
        at = int(np.clip(np.searchsorted(clock, counts.at(count)), 0, len(own) - 1))
        if clock[at] - times[-1] < 0.5:
            continue
        most = FASTEST_M_S * float(clock[at] - times[-1])
        shifts.append(shifts[-1] + at_most(goal - path[at] - shifts[-1], most))
        times.append(float(clock[at]))
    laid = glide(clock, np.array(times), np.stack(shifts))
    far = np.linalg.norm(path + laid, axis=1, keepdims=True)
    return np.asarray(laid - (path + laid) * np.maximum(far - EDGE_M, 0) / np.maximum(far, EDGE_M))


def _stepped(own: Controls, wanted: Float[Array, "t 2"]) -> tuple[Float[Array, "t 2 2"], Float[Array, "t 2"]]:
    """What each foot takes of the wanted shift in its steps, and how high it is lifted for that."""
    shift, lift = np.zeros((len(own), 2, 2), np.float32), np.zeros((len(own), 2), np.float32)
    swings = sorted((a, b, c, side) for side in range(2) for a, b, c in _swings(_stands(own, side)))
    for a, b, until, side in swings:
        phase = (np.arange(a, b) - a + 1) / (b - a + 1)
        before, other = shift[a, side].copy(), shift[b - 1, 1 - side]
        after = wanted[min(b, len(own) - 1) : until].mean(0) if b < until else wanted[-1]
        after = other + at_most(after - other, APART_M)
        after = before + at_most(after - before, SWING_M_S * (b - a) / FRAME_RATE_HZ)
        at = min(b, len(own) - 1)
        after = _within_stride(own, at, side, _uncrossed(own, at, side, after, other), other)
        shift[a:b, side] = before + (after - before) * minimum_jerk((phase - 0.15) / 0.7)[:, None]
        shift[b:, side] = after
        lift[a:b, side] = LIFT_M * min(1.0, float(np.hypot(*(after - before))) / 0.2) * np.sqrt(np.sin(np.pi * phase))
    return shift, lift


def _stands(own: Controls, side: int) -> Bool[Array, " t"]:
    """Where a foot stands: low, with the ball at rest."""
    yaw = own.foot_yaw[:, side]
    ball = own.foot_position[:, side, ::2] + BALL_M * np.stack([np.sin(yaw), np.cos(yaw)], -1)
    still = np.linalg.norm(np.diff(ball, axis=0), axis=-1) * FRAME_RATE_HZ < STILL_M_S
    rests = np.concatenate([still[:1], still[1:] & still[:-1], still[-1:]])
    rests = rests | np.append(still, False) | np.append(False, still)
    return np.asarray(rests & (own.foot_position[:, side, 1] < ANKLE_HEIGHT + LOW_M))


def _swings(stands: Bool[Array, " t"]) -> list[tuple[int, int, int]]:
    """First frame and end of each way between two stands, and the end of the stand after it."""
    spans = spans_of(stands)
    return [(a, b, c) for (_, a), (b, c) in pairwise(spans)]


def _uncrossed(own: Controls, at: int, side: int, shift: Array, other: Array) -> Float[Array, " 2"]:
    """A shift of one foot that leaves room between the feet, sideways, as far as the dance itself does."""
    yaw = float(own.pelvis_rotation[at, 0])
    outwards = np.array([np.cos(yaw), -np.sin(yaw)]) * (1 if side == 0 else -1)
    apart = float((own.foot_position[at, side, ::2] - own.foot_position[at, 1 - side, ::2]) @ outwards)
    lack = min(apart, CLOSEST_M) - (apart + float((shift - other) @ outwards))
    return np.asarray(shift + max(lack, 0.0) * outwards)


def _within_stride(own: Controls, at: int, side: int, shift: Array, other: Array) -> Float[Array, " 2"]:
    """A shift of one foot that sets it no further from the other one than legs can be apart with ease."""
    apart = own.foot_position[at, side, ::2] - own.foot_position[at, 1 - side, ::2]
    far = max(float(np.hypot(*apart)), WIDEST_M)
    return np.asarray(other + at_most(apart + shift - other, far) - apart)
