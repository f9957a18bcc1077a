"""Captured dances to any music: their own counts are laid on the music's beats. Not in the paper.

A clip's counts are where the dancing body slows down, evenly spaced as far as the clip is. Stretches of whole counts
are played so that counts meet beats, at a rate near the captured one, and joined where bodies match (`motion_graph`).
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import binary_dilation, gaussian_filter1d, maximum_filter1d

from echoavatar.corpora.rehearsal.controls import Array, Controls, mirrored, moved
from echoavatar.corpora.rehearsal.solver import solve
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.timing import FRAME_RATE_HZ

from .footfalls import with_footfalls
from .library import CapturedLibrary
from .motion_graph import joined, poses_of, varied

SHORTEST_S = 5.0
COUNT_S = (0.30, 0.42)  # from step to step
RATES, USUAL_RATE = (0.55, 1.15), 0.8  # of playback; captured dancers are livelier than most music asks for
LOWEST_PELVIS_M, DEEPEST_LEAN = 0.78, 0.50  # a dancer who is lower or leans further is on the floor or in a flip
FASTEST_DEG_S = 1000.0  # of any joint at the captured tempo
STRETCH = (12, 33)  # counts from one join to the next
COMPARED, GOOD = 250, 3  # entries compared for a join, of which one of the best is drawn
AWAY = 0.25  # weight of a metre away from the middle against a metre of distance between poses
BACK = 0.35  # weight of a dancer who ends with the back to the front
ANSWER_S = 0.02  # from a beat to its count
USUAL_FRAMES = 11  # from step to step, about 0.37 s
SIZES = (0.9, 1.2)
MOST_TILT = 0.85  # of a foot, radians; near a quarter turn its angles flip
SLOWEST_FEET_M_S = 0.3  # slower dances have no steps to count
LEFT_OUT = ("whirl", "modern", "street")  # they turn on their feet, or have no steady steps


@dataclass(frozen=True, eq=False)
class CountedDance:
    """A captured dance with its counts."""

    group: str
    controls: Controls
    counts: Float[Array, " n"]  # frames
    poses: Float[Array, "n d"]  # at each count, as `motion_graph.poses_of`

    @property
    def period(self) -> float:
        """Seconds from count to count."""
        return float(np.median(np.diff(self.counts))) / FRAME_RATE_HZ


def captured_dance(
    library: CapturedLibrary, beats: Float[np.ndarray, " n"], begin: float, end: float, rng: np.random.Generator
) -> Controls | None:
    """Dance to these beats (seconds) from `begin` to `end`; None if no dance of the library fits their tempo."""
    frames = round((end - begin) * FRAME_RATE_HZ)
    wanted = _fitting(library, float(np.median(np.diff(beats)))) if len(beats) > 3 else []
    if not wanted or frames < 2 * FRAME_RATE_HZ:
        return None
    group, ratio = wanted[rng.integers(len(wanted))]
    size = float(rng.uniform(*SIZES))
    dances, times = _by_group(library)[group], _count_times(beats, ratio, begin, end)
    body: Controls | None = None
    at, now = begin, 0
    while body is None or len(body) < frames:
        dance, first = _entry(dances, body, rng)
        last = min(first + int(rng.integers(*STRETCH)), len(dance.counts) - 1)
        now = int(np.searchsorted(times, at - 1e-6)) if body is not None else now
        places = times[now : now + last - first + 1]
        if len(places) < 4:
            places = places[0] + np.arange(last - first + 1) * float(np.median(np.diff(times)))
        source = PchipInterpolator(places, dance.counts[first : first + len(places)], extrapolate=True)
        clock = at + np.arange(round((places[-1] - at) * FRAME_RATE_HZ)) / FRAME_RATE_HZ
        where = source(clock)
        if len(where) < 6 or where.min() < 0 or where.max() > len(dance.controls) - 1:
            where = np.clip(where, 0, len(dance.controls) - 1)
        piece = varied(_sampled(dance.controls, where), sway=size, lean=size, turn=size)
        body = _at_home(piece) if body is None else joined(body, _nearest_swing(body, piece))
        at = begin + len(body) / FRAME_RATE_HZ
    return _slowed(with_footfalls(body[:frames]))


def _fitting(library: CapturedLibrary, beat: float) -> list[tuple[str, float]]:
    """Groups with the counts per beat at which they keep most of their tempo; longer groups come more often."""
    found = []
    for group, dances in _by_group(library).items():
        period = float(np.median([dance.period for dance in dances]))
        rates = {ratio: period * ratio / beat for ratio in (0.5, 1.0, 2.0)}
        ratio = min(rates, key=lambda r: abs(np.log(rates[r] / USUAL_RATE)))
        if RATES[0] < rates[ratio] < RATES[1]:
            seconds = sum(len(dance.controls) for dance in dances) / FRAME_RATE_HZ
            found += [(group, ratio)] * max(1, round(np.sqrt(seconds) / 4))
    return found


def _count_times(beats: Float[np.ndarray, " n"], ratio: float, begin: float, end: float) -> Float[Array, " m"]:
    """When the counts fall: on beats, on every second one or twice a beat; the tempo goes on beyond both ends."""
    gap = float(np.median(np.diff(beats)))
    before = beats[0] - gap * np.arange(int(max(beats[0] - begin, 0) / gap) + 3, 0, -1)
    after = beats[-1] + gap * np.arange(1, int(max(end - beats[-1], 0) / gap) + 4)
    every = np.concatenate([before, beats, after])
    if ratio == 2.0:
        every = np.interp(np.arange(2 * len(every) - 1) / 2, np.arange(len(every)), every)
    elif ratio == 0.5:
        every = every[len(before) % 2 :: 2]
    every = every + ANSWER_S
    return np.asarray(every[every > begin - 0.5 * gap])


def _entry(dances: list[CountedDance], body: Controls | None, rng: np.random.Generator) -> tuple[CountedDance, int]:
    """A dance and a count to go on with: near the body's pose, and leading back to the middle."""
    rooms = np.array([max(len(dance.counts) - 8, 0) for dance in dances], float)
    picked = rng.choice(len(dances), size=COMPARED, p=rooms / rooms.sum())
    options = [(dances[i], int(rng.integers(0, int(rooms[i])))) for i in picked]
    if body is None:
        return options[0]
    here = poses_of(body[-4:])[-1]
    place = body.pelvis_position[-1, [0, 2]]
    heading = float(body.pelvis_rotation[-1, 0])
    costs = []
    for dance, first in options:
        ahead = int(dance.counts[min(first + 10, len(dance.counts) - 1)])
        start = int(dance.counts[first])
        way = (dance.controls.pelvis_position[ahead] - dance.controls.pelvis_position[start])[[0, 2]]
        turn = heading - float(dance.controls.pelvis_rotation[start, 0])
        goes = np.array([np.cos(turn) * way[0] + np.sin(turn) * way[1], np.cos(turn) * way[1] - np.sin(turn) * way[0]])
        faces = turn + float(dance.controls.pelvis_rotation[ahead, 0])
        cost = float(np.linalg.norm(dance.poses[first] - here)) + AWAY * float(np.linalg.norm(place + goes))
        costs.append(cost + BACK * (1 - float(np.cos(faces))))
    return options[int(rng.choice(np.argsort(costs)[:GOOD]))]


def _at_home(piece: Controls) -> Controls:
    """A first stretch that starts over the origin and faces +Z."""
    piece = moved(piece, -piece.pelvis_position[0, [0, 2]])
    return moved(piece, np.zeros(2), turn=-float(piece.pelvis_rotation[:FRAME_RATE_HZ, 0].mean()))


def _nearest_swing(before: Controls, after: Controls) -> Controls:
    """`after` with its elbows' angles shifted by whole turns to those of `before`."""
    whole = 2 * np.pi * np.round((before.elbow_swing[-1] - after.elbow_swing[0]) / (2 * np.pi))
    return replace(after, elbow_swing=(after.elbow_swing + whole).astype(np.float32))


def _sampled(controls: Controls, where: Float[np.ndarray, " t"]) -> Controls:
    """Controls at any frames, by linear interpolation."""
    table = controls.packed()
    low = np.clip(np.floor(where).astype(int), 0, len(table) - 2)
    share = (where - low)[:, None]
    return Controls.unpacked(table[low] * (1 - share) + table[low + 1] * share)


@lru_cache(maxsize=2)
def _by_group(library: CapturedLibrary) -> dict[str, list[CountedDance]]:
    """All dances that can be used, by group, each with its mirror image."""
    parts: dict[str, list[Controls]] = defaultdict(list)
    for clip in library.of("dance"):
        if clip.group in LEFT_OUT:
            continue
        parts[clip.group] += _upright(clip.controls)
    found: dict[str, list[CountedDance]] = defaultdict(list)
    for group, dances in parts.items():
        period = find_period([_pulse(dance) for dance in dances])
        for part in dances:
            for side in (part, mirrored(part)):
                counts = find_counts(_pulse(side), period)
                if len(counts) >= 12:
                    poses = poses_of(side)[np.round(counts).astype(int).clip(0, len(side) - 1)]
                    found[group].append(CountedDance(group, side, counts, poses))
    return dict(found)


def _slowed(controls: Controls) -> Controls:
    """The same dance with arms and legs smoothed where a joint is too fast, as at joins of unlike poses."""
    for _ in range(3):
        fast = maximum_filter1d((_joint_speed(controls) > FASTEST_DEG_S).astype(float), 9)
        if not fast.any():
            break
        share = gaussian_filter1d(fast, 2.0)
        curves = {}
        for name in ("wrist", "elbow_swing", "palm", "shoulder", "knee_swing", "spine", "head", "pelvis_rotation"):
            old = getattr(controls, name)
            soft = gaussian_filter1d(old, 3.0, axis=0, mode="nearest")
            curves[name] = (old + share.reshape(-1, *([1] * (old.ndim - 1))) * (soft - old)).astype(np.float32)
        controls = replace(controls, **curves)
    return controls


def _joint_speed(controls: Controls) -> Float[Array, " t"]:
    """Speed of the fastest joint, degrees a second."""
    rotations, _ = solve(controls)
    cosine = np.abs((rotations[1:] * rotations[:-1]).sum(-1)).clip(0, 1)
    speed = np.degrees(2 * np.arccos(cosine)).max(1) * FRAME_RATE_HZ
    return np.append(speed, speed[-1:])


def _upright(controls: Controls) -> list[Controls]:
    """The stretches in which the dancer is on the feet, upright enough, and no joint is faster than it may be."""
    lean = np.abs(controls.pelvis_rotation[:, 1:]).max(1)
    good = (controls.pelvis_position[:, 1] > LOWEST_PELVIS_M) & (lean < DEEPEST_LEAN)
    good &= _joint_speed(controls) < FASTEST_DEG_S
    tilt = np.maximum(np.abs(controls.foot_roll), np.abs(controls.foot_pitch) / 1.3).max(1)
    good &= binary_dilation(tilt > MOST_TILT, np.ones(7)) == 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]]))).reshape(-1, 2)
    steps = np.linalg.norm(np.gradient(controls.foot_position, axis=0), axis=-1).mean(1) * FRAME_RATE_HZ
    return [
        controls[a:b] for a, b in edges if b - a >= SHORTEST_S * FRAME_RATE_HZ and steps[a:b].mean() > SLOWEST_FEET_M_S
    ]


def _pulse(controls: Controls) -> Float[Array, " t"]:
    """Deceleration of the whole body, of unit deviation: where it is high, the body arrives somewhere."""
    rotations, root = solve(controls)
    places = gaussian_filter1d(
        Motion(HUMANOID, rotations, root, float(FRAME_RATE_HZ)).pose().positions.numpy(), 1.2, axis=0
    )
    speed = np.linalg.norm(np.diff(places, axis=0), axis=-1).mean(1)
    braking = np.maximum(-np.diff(speed, prepend=speed[:1], append=speed[-1:]), 0.0)
    return np.asarray(braking / (braking.std() + 1e-9))


def find_period(pulses: Sequence[Float[Array, " t"]]) -> float:
    """Frames from count to count that all these dances share: the greatest mean autocorrelation."""
    lags = np.arange(round(COUNT_S[0] * FRAME_RATE_HZ), round(COUNT_S[1] * FRAME_RATE_HZ) + 1)
    long = [pulse for pulse in pulses if len(pulse) > 2 * lags[-1]]
    alike = [sum(float((pulse[lag:] * pulse[:-lag]).sum()) for pulse in long) for lag in lags]
    usual = np.exp(-0.5 * (np.log2(lags / USUAL_FRAMES) / 0.5) ** 2)
    return float(lags[int(np.argmax(np.array(alike) * usual))])


def find_counts(pulse: Float[Array, " t"], period: float) -> Float[Array, " n"]:
    """Counts of a dance, in frames: a path through its slow moments, about evenly spaced.

    The path is found by dynamic programming, as beat trackers do (Ellis, Beat Tracking by Dynamic Programming, 2007).
    """
    reach = np.arange(round(0.6 * period), round(1.6 * period) + 1)
    if len(pulse) < 3 * reach[-1]:
        return np.zeros(0)
    score, before = pulse.copy(), np.full(len(pulse), -1)
    cost = 6.0 * np.log(reach / period) ** 2
    for t in range(int(reach[-1]), len(pulse)):
        options = score[t - reach] - cost
        best = int(options.argmax())
        score[t] += options[best]
        before[t] = t - reach[best]
    path = [int(len(pulse) - reach[-1] + score[-int(reach[-1]) :].argmax())]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return np.array(path[::-1], np.float64)
