"""Bends of the trunk and levels of the hips, laid over a dance: deeper in louder music, reached on its counts.

Some dances hardly bend and some go deep, as among people; over captured dancers most bends are small. The hips go back
and down while the trunk bows, so the body stays over its feet. A dance that bends already gets less.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ

from ..controls import Array, Controls, minimum_jerk, smoothed
from ..keyframes import glide
from .grooves import Counts

FORWARD, BACK, ASIDE = 0.62, -0.14, 0.16  # radians in the loudest music
QUIET = 0.55  # share of them in the quietest
SIZE_BY_RULE = 1.05, 0.8  # of a dance's bends: median, and log-normal deviation from dance to dance
SIZE_CAPTURED = 0.25, 1.7  # over captured dancers, who bend of their own; a few dances are deep nevertheless
LARGEST = 2.6
MOST_BOW = 1.15  # radians, however large the dance
PELVIS = 0.45  # share of a bow in the hips; the spine has the rest
LOOK = 0.6  # share of a bow that the head makes up for
BACKWARDS_M, DOWN_M = 0.24, 0.14  # of the hips per radian of a bow
DEEPEST = 0.9  # radians: a dance that bends so far gets no more
ANSWER_S = 0.06  # after the count, as in dances by rule
TRAVEL = 0.8  # of the time between two bends: the rest is held
IN_S, OUT_S = 2.0, 0.8
LONG_S = 0.8  # between two bends at least


def with_bends(dance: Controls, counts: Counts, rng: np.random.Generator, size: tuple[float, float]) -> Controls:
    """The same dance with bends in one music span; the feet stay where they are.

    `size`, the median and deviation of how deep a dance bends, is `SIZE_BY_RULE` or `SIZE_CAPTURED`.
    """
    first, last = counts.frames(OUT_S, len(dance))
    if last - first < FRAME_RATE_HZ:
        return dance
    times, values = _keys(counts, rng, size)
    clock = np.arange(first, last) / FRAME_RATE_HZ
    bow, aside = glide(clock, times, values, TRAVEL * np.diff(times, prepend=times[0] - LONG_S)).T
    presence = minimum_jerk((clock - counts.start) / IN_S) * minimum_jerk((counts.end + OUT_S - clock) / OUT_S)
    own = dance.pelvis_rotation[first:last, 1] + dance.spine[first:last, 1]
    room = smoothed(np.clip(1 - np.abs(own) / DEEPEST, 0, 1), 0.3)
    return _bent(dance, first, bow * presence * room, aside * presence * room)


def _keys(
    counts: Counts, rng: np.random.Generator, size: tuple[float, float]
) -> tuple[Float[Array, " k"], Float[Array, "k 2"]]:
    """Times, and a bow and a bend to the side in each: down and up in turns, the same in every second phrase."""
    apart = counts.apart(LONG_S, 3 if counts.metre == 3 else 2)
    times, values, motif = [counts.start], [np.zeros(2)], np.zeros((4, 2))
    median, spread = size
    depth = min(median * float(np.exp(spread * rng.standard_normal())), LARGEST)
    for number in range((len(counts.times) - 1) // apart + 1):
        if number % 8 == 0:
            down, up = rng.uniform(0.55, 1.0, 2) * FORWARD, rng.uniform(0.2, 1.0, 2) * BACK
            bows = np.minimum(depth * np.stack([down, up], 1).ravel(), MOST_BOW)
            motif = np.stack([bows, min(depth, 1.0) * ASIDE * rng.uniform(-1, 1, 4)], 1)
        time = counts.at(number * apart) + ANSWER_S
        if time > times[-1] + 0.5 * LONG_S:
            times.append(time)
            values.append(motif[number % 4] * (QUIET + (1 - QUIET) * counts.energy(number * apart)))
    return np.array(times), np.array(values)


def _bent(dance: Controls, first: int, bow: Float[Array, " n"], aside: Float[Array, " n"]) -> Controls:
    span = slice(first, first + len(bow))
    place, hips = dance.pelvis_position.copy(), dance.pelvis_rotation.copy()
    spine, head = dance.spine.copy(), dance.head.copy()
    yaw = hips[span, 0]
    place[span] -= np.stack([np.sin(yaw) * BACKWARDS_M * bow, DOWN_M * np.abs(bow), np.cos(yaw) * BACKWARDS_M * bow], 1)
    hips[span, 1] += PELVIS * bow
    spine[span, 1] += (1 - PELVIS) * bow
    spine[span, 2] += aside
    head[span, 1] -= LOOK * bow
    head[span, 2] -= LOOK * aside
    return replace(dance, pelvis_position=place, pelvis_rotation=hips, spine=spine, head=head)
