"""Foot curves of the dance from planned footholds: swing arcs, heel and toe, and the weight on each foot.

A planted foot does not move at all. Curves between footholds are twice continuously differentiable.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..controls import ANKLE_HEIGHT, STANDING_FEET, STANDING_FOOT_YAW, Array, air, minimum_jerk, smoothed
from ..keyframes import glide

PLACES = tuple((x, z) for x, _, z in STANDING_FEET)  # of both feet at ease, left then right
TOE_OFF = 0.32  # radians of heel lift as the foot leaves the floor
SUPPORT = 0.95  # share of the weight on the standing foot while the other swings
WEIGHT_SECONDS = 0.03  # from landing until the foot carries the weight, so that it does so on the count
TRANSFER_SECONDS = 0.38  # the weight begins to move at most this long before the landing
ROLL_SECONDS = 0.10  # from the first touch of heel or ball to the flat foot


@dataclass(frozen=True)
class Foothold:
    """A planned step in world space: when the foot lifts off and lands (seconds), and where (metres, radians)."""

    side: int
    lift_off: float
    landing: float
    place: tuple[float, float]  # x, z of the flat ankle
    yaw: float
    weight: float = 1.0
    lift: float = 0.07
    pitch: float = 0.0
    strike: float = 0.0  # pitch at the first touch
    air: tuple[float, float, float, float] | None = None  # way point in the air: time, x, height, z


@dataclass(frozen=True)
class Footwork:
    """Curves of both feet and of the weight on them, frames first."""

    position: Float[Array, "t 2 3"]
    yaw: Float[Array, "t 2"]
    pitch: Float[Array, "t 2"]
    share: Float[Array, " t"]  # of the weight on the left foot


def walk(t: Array, holds: Sequence[Foothold], shifts: Sequence[tuple[float, float]] = ()) -> Footwork:
    """Curves at times `t` from footholds in order, begun at ease.

    `shifts` are (seconds, share of the weight on the left foot).
    """
    sides = [[hold for hold in holds if hold.side == side] for side in (0, 1)]
    place, yaw = zip(*(_path(t, sides[s], PLACES[s], STANDING_FOOT_YAW[s]) for s in (0, 1)), strict=True)
    pitch = [_pitch(t, sides[s]) for s in (0, 1)]
    return Footwork(np.stack(place, 1), np.stack(yaw, 1), np.stack(pitch, 1), _share(t, holds, shifts))


def _path(t: Array, holds: Sequence[Foothold], start: tuple[float, float], yaw: float) -> tuple[Array, Array]:
    position = np.zeros((len(t), 3))
    position[:] = (start[0], ANKLE_HEIGHT, start[1])
    heading = np.full(len(t), yaw)
    before, before_yaw = np.array(start), yaw
    for hold in holds:
        first, last = np.searchsorted(t, [hold.lift_off, hold.landing])
        phase = (t[first:last] - hold.lift_off) / (hold.landing - hold.lift_off)
        place = np.array(hold.place)
        if hold.air is None:
            share = minimum_jerk(phase)[:, None]
            position[first:last, ::2] = before + (place - before) * share
            position[first:last, 1] += hold.lift * air(phase)
        else:
            position[first:last] = _through_air(t[first:last], hold, before)
        heading[first:last] = before_yaw + (hold.yaw - before_yaw) * minimum_jerk(phase)
        position[last:] = (place[0], ANKLE_HEIGHT, place[1])
        heading[last:] = hold.yaw
        before, before_yaw = place, hold.yaw
    return position, heading


def _through_air(t: Array, hold: Foothold, before: Array) -> Array:
    assert hold.air is not None
    at, x, height, z = hold.air
    way = np.array([before, (x, z), hold.place])
    keys = np.insert(way, 1, ANKLE_HEIGHT + np.array([0.0, height, 0.0]), axis=1)
    return glide(t, np.array([hold.lift_off, at, hold.landing]), keys)


def _pitch(t: Array, holds: Sequence[Foothold]) -> Array:
    """Foot pitch: the heel rises before lift-off, heel or ball touches first, then the foot settles."""
    keys: list[tuple[float, float, float]] = [(float(t[0]) - 1.0, 0.0, 0.1)] if len(t) else []
    standing = 0.0
    for hold in holds:
        length = hold.landing - hold.lift_off
        push = TOE_OFF if standing >= 0 else 0.0
        touch = hold.strike if hold.pitch == 0 else hold.pitch
        wanted = [(hold.lift_off + 0.25 * length, max(push, standing), 0.25 * length + 0.13)]
        if touch <= 0:
            wanted.append((hold.lift_off + 0.72 * length, 0.0, 0.5 * length))
        wanted.append((hold.landing, touch, 0.28 * length if touch <= 0 else 0.6 * length))
        wanted.append((hold.landing + ROLL_SECONDS, hold.pitch, ROLL_SECONDS))
        for key in wanted:
            while keys and keys[-1][0] > key[0] - 0.03 and len(keys) > 1:
                keys.pop()
            keys.append(key)
        standing = hold.pitch
    table = np.array(keys)
    return glide(t, table[:, 0], table[:, 1:2], table[:, 2])[:, 0]


def _share(t: Array, holds: Sequence[Foothold], shifts: Sequence[tuple[float, float]]) -> Array:
    keys = [(-1e3, 0.5, 1.0)]  # time, share, longest travel
    for hold in sorted(holds, key=lambda h: h.lift_off):
        standing = 1 - SUPPORT if hold.side == 0 else SUPPORT
        carried = 0.92 * hold.weight if hold.side == 0 else 1 - 0.92 * hold.weight
        keys.append((hold.lift_off + 0.02, standing, 0.8))
        if hold.landing - TRANSFER_SECONDS > hold.lift_off + 0.05:
            keys.append((hold.landing - TRANSFER_SECONDS, standing, 0.8))
        keys.append((hold.landing + WEIGHT_SECONDS, standing if hold.weight < 0.02 else carried, 0.8))
    keys = sorted([*keys, *((time, share, 1.6) for time, share in shifts)])
    table = np.array(keys)
    times = np.maximum.accumulate(table[:, 0] + 1e-6 * np.arange(len(table)))
    curve = glide(t, times, table[:, 1:2], table[:, 2])
    return np.asarray(smoothed(curve, 0.04), np.float64)[:, 0]
