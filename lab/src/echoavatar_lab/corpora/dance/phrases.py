"""Captured people who dance to any music: phrases of their dances joined and warped so that counts meet beats.

A phrase may follow another one where pose and phase match (after Kovar et al., Motion Graphs, 2002). Between counts,
time runs by PCHIP. At each join the dancer is turned and shifted a little towards the front and the middle. Turns and
travel stay.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from echoavatar.timing import FRAME_RATE_HZ

from ..controls import (
    DRIFT_FRAMES,
    FEET,
    Array,
    Controls,
    at_most,
    concatenated,
    facing,
    fading,
    gap,
    moved,
    smoothed,
    turned,
    unwound,
    wrists_over,
)
from ..solver import solve
from .dance_graph import Dance, Stretches, joint_speed, stretches_of
from .footfalls import with_footfalls
from .grooves import Counts

PHRASE = 8  # beats
SHORT_SHARE = 0.3  # of the phrases are half as long
NEAREST = 3  # of the best followers one is drawn
LINGER = 0.28  # share by which a dancer's time runs faster and slower about a beat, slowing down on it
AFTER_S = 1.0  # for which the dance goes on after the music, for feet that wait for their last step
FADE_S, STEP_S = 0.6, 0.33
TURNED = 1.45  # the trunk against the hips as captured: the salsa turns less than other dances
FACING, AWAY = 1.2, 1.1  # cost of a stretch that faces backwards, and of each metre off the middle
NEAR_M = 0.6  # from the middle: this near costs nothing
SIZE, SPREAD, LARGEST = 1.15, 0.35, 2.0  # of a dance's movement: median, log-normal deviation, most
MOST_TURN = 1.0  # radians, of the shoulders against the hips: as far as people can
HOME_TURN, HOME_M = 0.5, 0.15  # most that a join turns and shifts the dancer
FASTEST_DEG_S = 1000.0  # of any joint: faster stretches are smoothed
ROUNDS, SOFT_S = 3, 0.1
FOLDED_M = 0.16  # from a shoulder to its wrist: a folded arm, which is not made smaller
KEPT_M = 0.03  # feet that are both off by more than this step in turn


@dataclass(frozen=True, eq=False)
class Phrase:
    """A stretch of a dance, and the beats on which it is danced."""

    dance: Dance
    first: int
    counts: int
    begin: int
    beats: int
    energy: float


def can_dance(dances: tuple[Dance, ...], groups: tuple[str, ...], counts: Counts) -> bool:
    """Whether some dancers have enough material at the tempo of a piece."""
    return len(stretches_of(dances, groups, *_half(counts))) >= 24


def captured_dance(
    dances: tuple[Dance, ...], groups: tuple[str, ...], counts: Counts, rng: np.random.Generator
) -> tuple[int, Controls]:
    """The number of the first frame, and curves from the start of a piece to a little after its end.

    Raises ValueError if nothing fits the tempo; ask `can_dance` before.
    """
    phrases = choose(dances, groups, counts, rng)
    body: Controls | None = None
    first = int(np.ceil(counts.beat(phrases[0].begin) * FRAME_RATE_HZ))
    size = min(SIZE * float(np.exp(SPREAD * rng.standard_normal())), LARGEST)
    for phrase in phrases:
        made = _played(phrase, counts, size, rng)
        body = _at_home(made) if body is None else concatenated([body, _joined(body, made)])
    assert body is not None
    spine = body.spine.copy()
    spine[:, 0] = MOST_TURN * np.tanh(spine[:, 0] / MOST_TURN)
    return first, _slowed(with_footfalls(_slowed(replace(body, spine=spine))), without=FEET)


def choose(
    dances: tuple[Dance, ...], groups: tuple[str, ...], counts: Counts, rng: np.random.Generator
) -> list[Phrase]:
    """The phrases of a dance from before the start of a piece until after its end.

    Raises ValueError if nothing fits the tempo.
    """
    half, beat_s = _half(counts)
    long, number = 2 * half, 0
    sections = np.array([counts.at(first) for first, _, _ in counts.sections])
    while counts.beat(number) > counts.start:
        number -= 1
    kinds = {beats: kind for beats in (long, half) if len(kind := stretches_of(dances, groups, beats, beat_s))}
    if not kinds:
        raise ValueError("no captured dance fits this tempo")
    used = {beats: np.zeros(len(kind)) for beats, kind in kinds.items()}
    here: Array | None = None
    state = np.zeros(3)  # x, z, heading
    found: list[Phrase] = []
    while counts.beat(number) < counts.end + AFTER_S:
        section = int(np.searchsorted(sections, counts.beat(number + 1) + 1e-6)) - 1
        energy = counts.sections[max(section, 0)][2]
        is_short = rng.random() < SHORT_SHARE or number % long != 0
        beats = min(kinds) if is_short else max(kinds)
        kind = kinds[beats]
        cost, turn, shift = _costs(kind, here, state, energy)
        cost = cost + 0.5 * used[beats]
        best = np.argsort(cost)[: NEAREST if here is not None else 24]
        pick = int(rng.choice(best))
        dance = dances[kind.dance[pick]]
        used[beats] *= 0.9
        used[beats] += np.exp(-0.5 * ((kind.first - kind.first[pick]) / 6.0) ** 2) * (
            kind.dance // 2 == kind.dance[pick] // 2
        )
        phrase = Phrase(dance, int(kind.first[pick]), int(kind.counts[pick]), number, beats, energy)
        found.append(phrase)
        here = dance.poses[round(dance.counts[phrase.first + phrase.counts])]
        state = _after(dance, phrase, state + np.array([*shift[pick], turn[pick]]))
        number += beats
    return found


def _half(counts: Counts) -> tuple[int, float]:
    """Beats of half a phrase, and seconds of a beat."""
    half = 6 if counts.metre == 3 else PHRASE // 2
    return half, (counts.beat(half * 4) - counts.beat(0)) / (half * 4)


def _costs(
    kind: Stretches, here: Array | None, state: Float[Array, " 3"], energy: float
) -> tuple[Float[Array, " k"], Float[Array, " k"], Float[Array, "k 2"]]:
    """How badly each stretch follows, and the turn and shift towards home that its join makes."""
    apart = np.zeros(len(kind)) if here is None else np.sqrt(((kind.poses - here) ** 2).sum(1))
    heading = state[2] + kind.heading
    wrapped = (heading + np.pi) % (2 * np.pi) - np.pi
    turn = np.clip(-wrapped, -HOME_TURN, HOME_TURN)
    off = state[:2] + turned(kind.way, state[2] + turn)
    far = np.linalg.norm(off, axis=1)
    shift = -off * np.minimum(1.0, HOME_M / np.maximum(far, 1e-6))[:, None]
    left = np.linalg.norm(off + shift, axis=1)
    away = FACING * (1 - np.cos(heading + turn)) + AWAY * np.maximum(left - NEAR_M, 0)
    fits = 0.8 * np.abs(kind.energy - (0.3 + 0.6 * energy)) + 0.3 * np.abs(np.log(kind.rate))
    return apart + away + fits, turn, shift


def _after(dance: Dance, phrase: Phrase, state: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Place and heading after a phrase that is begun in a place and heading."""
    a, b = (round(dance.counts[phrase.first + n]) for n in (0, phrase.counts))
    place, yaw = dance.controls.pelvis_position, dance.controls.pelvis_rotation[:, 0]
    way = turned((place[b] - place[a])[[0, 2]], state[2] - yaw[a])
    return np.array([*(state[:2] + way), state[2] + yaw[b] - yaw[a]])


def _played(phrase: Phrase, counts: Counts, size: float, rng: np.random.Generator) -> Controls:
    """A phrase in the time of its beats, larger in louder music."""
    beats = phrase.begin + np.arange(phrase.counts + 1) * phrase.beats / phrase.counts
    times = np.array([counts.beat(float(b)) for b in beats])
    begin, end = (int(np.ceil(t * FRAME_RATE_HZ)) for t in (times[0], times[-1]))
    clock = np.arange(begin, end) / FRAME_RATE_HZ
    warp = PchipInterpolator(times, phrase.dance.counts[phrase.first : phrase.first + phrase.counts + 1])
    number = np.interp(clock, times, beats)
    beat_s = (times[-1] - times[0]) / phrase.beats
    felt = clock + LINGER * beat_s / (2 * np.pi) * (np.cos(2 * np.pi * number) - 1)
    made = phrase.dance.at(np.maximum(warp(np.clip(felt, times[0], times[-1])), 0))
    return _sized(made, size * float(0.92 + 0.2 * phrase.energy + rng.uniform(-0.06, 0.06)))


def _sized(controls: Controls, size: float) -> Controls:
    """The same phrase with larger or smaller movement of arms, trunk and height; the feet as they are.

    The trunk bends and tilts as captured at most, so that it stays over the feet.
    """
    wrist, spine = controls.wrist, controls.spine
    free = np.clip((np.linalg.norm(wrist, axis=-1, keepdims=True) - FOLDED_M) / FOLDED_M, 0, 1)
    trunk = np.array([TURNED * size, min(size, 1.0), min(size, 1.0)])
    height = controls.pelvis_position.copy()
    height[:, 1] += (min(size, 1.0) - 1) * (height[:, 1] - height[:, 1].mean())
    return replace(
        controls,
        pelvis_position=height,
        spine=(spine + (trunk - 1) * (spine - spine.mean(0))).astype(np.float32),
        wrist=(wrist + (size - 1) * free * (wrist - wrist.mean(0))).astype(np.float32),
    )


def _at_home(controls: Controls) -> Controls:
    """The first phrase, over the origin and to the front on average."""
    ahead = moved(controls, np.zeros(2), turn=-facing(controls))
    return moved(ahead, -ahead.pelvis_position[:, [0, 2]].mean(0))


def _joined(before: Controls, after: Controls) -> Controls:
    """`after` as it follows `before`: where the dancer is, a little towards home; what differs fades out.

    The foot that is further off goes to its new place at once, the other one after it.
    """
    after = unwound(_placed(before, after), before, 0, -1)
    far = np.linalg.norm(before.foot_position[-1] - after.foot_position[0], axis=-1)
    step = round(STEP_S * FRAME_RATE_HZ)
    curves: dict[str, Array] = {}
    for field in fields(Controls):
        old, new = getattr(before, field.name), getattr(after, field.name).copy()
        place, speed = gap(old, new)
        if field.name == "wrist":
            ends = np.stack([old[-1], 2 * old[-1] - old[-2]])
            new = wrists_over(ends, np.concatenate([2 * new[:1] - new[1:2], new]), round(FADE_S * FRAME_RATE_HZ))
        elif field.name not in FEET:
            new += fading(place, speed, round(FADE_S * FRAME_RATE_HZ), len(new), drift=DRIFT_FRAMES)
        else:
            for side in range(2):
                waits = step if side == far.argmin() and far.min() > KEPT_M else 0
                speed[side] *= waits == 0
                new[:waits, side] += place[side]
                new[waits:, side] += fading(place[side], speed[side], step, len(new) - waits, drift=DRIFT_FRAMES)
        curves[field.name] = new
    return replace(after, **curves)


def _placed(before: Controls, after: Controls) -> Controls:
    """`after` where `before` ends, turned and shifted towards home."""
    turn = float(before.pelvis_rotation[-1, 0] - after.pelvis_rotation[0, 0])
    after = moved(after, -after.pelvis_position[0, [0, 2]])
    after = moved(after, np.zeros(2), turn=turn)
    home = float(np.clip(-facing(after), -HOME_TURN, HOME_TURN))
    after = moved(after, before.pelvis_position[-1, [0, 2]], turn=home)
    return moved(after, -at_most(after.pelvis_position[:, [0, 2]].mean(0), HOME_M))


def _slowed(controls: Controls, *, without: tuple[str, ...] = ()) -> Controls:
    """The same dance with curves smoothed where a joint is too fast, as at joins of unlike poses."""
    for _ in range(ROUNDS):
        fast = maximum_filter1d((joint_speed(solve(controls)[0]) > FASTEST_DEG_S).astype(float), 9)
        if not fast.any():
            break
        share = gaussian_filter1d(fast, 2.0)
        curves = {}
        for field in fields(Controls):
            if field.name not in without:
                old = getattr(controls, field.name)
                soft = _soft_wrist(old) if field.name == "wrist" else smoothed(old, SOFT_S)
                curves[field.name] = old + share.reshape(-1, *([1] * (old.ndim - 1))).astype(np.float32) * (soft - old)
        controls = replace(controls, **curves)
    return controls


def _soft_wrist(wrist: Float[Array, "t 2 3"]) -> Float[Array, "t 2 3"]:
    """Direction and length apart, so that a hand near its shoulder is not drawn into it."""
    length = np.linalg.norm(wrist, axis=-1, keepdims=True)
    aim = smoothed(wrist / length, SOFT_S)
    return np.asarray(smoothed(length, SOFT_S) * aim / np.maximum(np.linalg.norm(aim, axis=-1, keepdims=True), 1e-6))
