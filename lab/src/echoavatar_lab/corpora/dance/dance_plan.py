"""Planning a dance: figures and moves in phrases of eight counts, A A B A' within a section, laid out in time.

Everything is locked to counts and changes at phrase borders. Sections of the same loudness share their material, so a
chorus repeats its dance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..controls import STANDING_FOOT_YAW, turned
from . import figures, moves, poses, steps
from .footwork import PLACES, Foothold
from .grooves import Counts
from .poses import ARMS, Key, Move
from .steps import Figure, Step

SECONDS_TO_CLOSE = 0.42
SHORTEST_SWING = 0.16
SLOW_COUNT = 0.75  # seconds; with longer counts the introduction is half as long
EASY_SWING = 0.46  # seconds that a full knee lift or kick needs
QUICK_COUNT = 0.5  # seconds; with shorter counts steps are smaller
TWIST = 1.6  # turn of the hips against the notation
CHEST = np.array([2.2, 1.5, 1.3])  # yaw, pitch and roll of the chest against the notation


@dataclass(frozen=True)
class BodyKey:
    """Arms, chest and head at one time: vector = left arm 16, right arm 16, chest 3, head 3."""

    time: float
    vector: NDArray[np.float64]
    travel: float
    flow: float


@dataclass
class DancePlan:
    """The plan of one music span: footholds, weight shifts, pelvis keys and body keys in time."""

    counts: Counts
    begin: float
    settle: float  # when the dancer starts to come to rest
    holds: list[Foothold] = field(default_factory=list)
    shifts: list[tuple[float, float]] = field(default_factory=list)
    twist: list[tuple[float, float]] = field(default_factory=list)
    dip: list[tuple[float, float]] = field(default_factory=list)
    body: list[BodyKey] = field(default_factory=list)
    level: list[tuple[float, float, float]] = field(default_factory=list)  # time, bounce scale, hips scale
    names: list[tuple[float, str, str]] = field(default_factory=list)  # time, figure, move: for tests and debugging


@dataclass(frozen=True)
class Material:
    """Figures and moves that the sections of one loudness share."""

    figures: tuple[Figure, Figure]
    moves: tuple[Move, Move, Move]

    @classmethod
    def drawn(cls, counts: Counts, energy: float, rng: np.random.Generator) -> "Material":
        """Draw two figures and three moves that fit."""
        legs = figures.fitting(counts.groove.name, counts.metre, energy)
        arms = moves.fitting(counts.groove.name, energy)
        typical = np.array([2.5 if figure.styles else 1.0 for figure in legs])
        pick = np.resize(rng.choice(len(legs), len(legs), replace=False, p=typical / typical.sum()), 2)
        hand = np.resize(rng.permutation(len(arms)), 3)
        return cls((legs[pick[0]], legs[pick[1]]), (arms[hand[0]], arms[hand[1]], arms[hand[2]]))


def compose_dance(counts: Counts, rng: np.random.Generator) -> DancePlan:
    """Plan the dance of one music span, which starts and ends in a standing pose."""
    last = counts.at(len(counts.times) - 1)
    beat = counts.length(len(counts.times) - 2)
    plan = DancePlan(counts, counts.start, float(np.clip(counts.end, last + 0.25, last + 1.1 * beat)))
    bank: dict[int, Material] = {}
    for first, end, energy in counts.sections:
        loudness = round(energy * 4)
        if loudness not in bank:
            bank[loudness] = Material.drawn(counts, energy, rng)
        _section(plan, bank[loudness], first, end, energy, rng)
    _close(plan)
    return plan


def _section(
    plan: DancePlan, material: Material, first: int, end: int, energy: float, rng: np.random.Generator
) -> None:
    size = 12 if plan.counts.metre == 3 else 8
    half = size // 2
    number, at = 0, first
    while at < end:
        length = min(size, end - at)
        if first == 0 and at < size:  # start small, then finish the phrase with the first figure
            listening = half // 2 if plan.counts.length(0) > SLOW_COUNT else half
            length = min(listening if at == 0 else size - at, end - at)
        figure = material.figures[1 if number % 4 == 2 else 0]
        move = material.moves[(0, 0, 1, 2)[number % 4]]
        if at == 0:
            figure, move = _listening(plan.counts)
        elif length < figure.counts:
            figure = _short(plan.counts, length)
        lively = energy * (0.6 if at == 0 else 1.0) * float(rng.uniform(0.94, 1.06))
        facing = float(rng.choice([-0.25, 0.0, 0.0, 0.25])) if energy > 0.4 and number % 4 in (2, 3) else 0.0
        _phrase(plan, figure, move, at, length, lively, facing)
        number += at > 0 or first > 0
        at += length


def _listening(counts: Counts) -> tuple[Figure, Move]:
    if counts.groove.name in moves.FLOWING:
        return figures.FIGURE["bounce"], moves.MOVE["soft_sway"]
    return figures.FIGURE["bounce"], moves.MOVE["loose_bounce"]


def _short(counts: Counts, length: int) -> Figure:
    """A figure for the end of a section that is shorter than a phrase."""
    if counts.metre == 3:
        return figures.FIGURE["waltz_balance"]
    is_slow = counts.groove.name in ("ballet", "rest")
    return figures.FIGURE["bounce" if length < 4 else "sway" if is_slow else "step_touch"]


def _phrase(plan: DancePlan, figure: Figure, move: Move, at: int, length: int, energy: float, facing: float) -> None:
    counts = plan.counts
    carrying = next((h.side for h in reversed(plan.holds) if h.weight > 0.5), None)
    is_mirrored = carrying is not None and steps.first_foot(figure) == carrying
    if is_mirrored:
        figure = steps.mirrored(figure)
    plan.names.append((counts.at(at), figure.name, move.name))
    size = float(np.clip(0.8 + 0.6 * energy, 0.8, 1.25)) * float(np.clip(counts.length(at) / QUICK_COUNT, 0.7, 1.0))
    plan.level.append((counts.at(at), figure.bounce * size, figure.hips * size))
    for lap in range(-(-length // figure.counts)):
        offset = at + lap * figure.counts
        until = at + length
        for step in figure.steps:
            if offset + step.count < until - 0.2:
                _place(plan, step, offset, size, facing)
        for count, yaw in figure.twist:
            plan.twist.append((counts.at(offset + count), TWIST * yaw * size))
        for count, depth in figure.dip:
            plan.dip.append((counts.at(offset + count), depth * size))
        plan.shifts += [(counts.at(offset + c), s) for c, s in figure.shift if offset + c < until - 0.2]
    if not figure.twist:
        plan.twist.append((counts.at(at + 1), 0.0))
    if not figure.dip:
        plan.dip.append((counts.at(at + 1), 0.0))
    _arms(plan, poses.mirrored(move) if is_mirrored and not move.is_fixed else move, at, length, energy)


def _place(plan: DancePlan, step: Step, offset: int, size: float, facing: float) -> None:
    """Add a figure's step to the plan as a foothold, unless there is no time for it."""
    counts = plan.counts
    landing = counts.at(offset + step.count) - 0.012
    lift_off = landing - float(np.clip(landing - counts.at(offset + step.count - step.travel), 0.2, 1.0))
    if plan.holds:
        lift_off = max(lift_off, plan.holds[-1].landing + 0.005)
    own = [h for h in plan.holds if h.side == step.side]
    if own:
        lift_off = max(lift_off, own[-1].landing + 0.09)
    air = None
    if step.air is not None:
        top = counts.at(offset + step.air[0]) - 0.012
        lift_off = min(lift_off, top - 0.2)
        time = min(top - lift_off, landing - top) * (1.0 if counts.unit == 1 else 0.66)
        size_air = min(size, 1.0, time / EASY_SWING)
        x, z = _world(step.side, step.air[1] * size_air, step.air[3] * size_air, facing)
        air = (top, x, step.air[2] * size_air, z)
    earliest = max((h.landing for h in plan.holds), default=-1.0)
    if landing - lift_off < SHORTEST_SWING or lift_off < earliest or lift_off < plan.begin:
        return
    place = _world(step.side, step.x * size, step.z * size, facing)
    before = own[-1].place if own else PLACES[step.side]
    ahead = np.cos(facing + step.yaw) * (place[1] - before[1]) + np.sin(facing + step.yaw) * (place[0] - before[0])
    far = float(np.hypot(place[0] - before[0], place[1] - before[1]))
    strike = -0.2 if ahead > 0.12 else (0.16 if far > 0.08 else 0.08)
    yaw = facing + step.yaw + STANDING_FOOT_YAW[step.side]
    lift = float(np.clip(step.lift * (0.75 + 0.3 * size), 0.042, 0.15))
    plan.holds.append(Foothold(step.side, lift_off, landing, place, yaw, step.weight, lift, step.pitch, strike, air))


def _world(side: int, x: float, z: float, facing: float) -> tuple[float, float]:
    """Place of a foot that stands off its place at ease, in the axes of a dancer who faces to the left by `facing`."""
    home = PLACES[side]
    place = turned(np.array([home[0] + x, home[1] + z]), facing)
    return float(place[0]), float(place[1])


def _arms(plan: DancePlan, move: Move, at: int, length: int, energy: float) -> None:
    """Add a move to a phrase; every second repetition is mirrored."""
    counts = plan.counts
    size = 1.0 if move.exact else float(np.clip(0.8 + 0.35 * energy, 0.8, 1.12))
    beats = move.counts * 3 // 2 if counts.metre == 3 else move.counts
    for lap in range(-(-length // beats)):
        variant = poses.mirrored(move) if lap % 2 and move.counts >= 4 and not move.is_fixed else move
        for key in variant.keys:
            count = key.count if counts.metre == 4 else 3 * (key.count // 2) + key.count % 2
            if lap * beats + count < length - 0.2:
                place = at + lap * beats + count
                travel = counts.at(place) - counts.at(place - move.travel * (1.5 if counts.metre == 3 else 1.0))
                plan.body.append(BodyKey(counts.at(place), _vector(key, size), travel, move.flow))


def _vector(key: Key, size: float) -> NDArray[np.float64]:
    arms = [ARMS[key.left].vector(), ARMS[key.right].vector()]
    easy = np.array(ARMS["loose"].wrist)
    for arm in arms:
        arm[:3] = easy + (arm[:3] - easy) * size
    return np.concatenate([*arms, CHEST * np.array(key.chest) * size, np.array(key.head) * size])


def _close(plan: DancePlan) -> None:
    """End with the music: drop later keys, step back to the neutral stance one foot at a time, lower the arms."""
    plan.holds = [h for h in plan.holds if h.lift_off < plan.settle - 0.05]
    plan.body = [k for k in plan.body if k.time < plan.settle + 0.12]
    plan.shifts, plan.twist, plan.dip = (
        [key for key in keys if key[0] < plan.settle + 0.1] for keys in (plan.shifts, plan.twist, plan.dip)
    )
    at = plan.settle + 0.05
    for side in _order(plan.holds):
        own = [h for h in plan.holds if h.side == side]
        if not own:
            continue
        at = max(at, plan.holds[-1].landing + 0.03)
        home = PLACES[side]
        far = np.hypot(own[-1].place[0] - home[0], own[-1].place[1] - home[1])
        if far > 0 or own[-1].pitch != 0 or own[-1].yaw != STANDING_FOOT_YAW[side]:
            lift = float(np.clip(0.035 + 0.08 * far, 0.042, 0.06))
            plan.holds.append(Foothold(side, at, at + SECONDS_TO_CLOSE, home, STANDING_FOOT_YAW[side], 0.54, lift))
    rest = max([plan.settle + 0.6, *(h.landing for h in plan.holds)])
    plan.shifts.append((rest + 0.25, 0.5))
    plan.twist.append((plan.settle + 0.7, 0.0))
    plan.dip.append((plan.settle + 0.7, 0.0))


def _order(holds: Sequence[Foothold]) -> tuple[int, int]:
    """Both feet in the order in which they return: the one with less weight first."""
    carrying = next((h.side for h in reversed(holds) if h.weight > 0.5), 0)
    return (1 - carrying, carrying)
