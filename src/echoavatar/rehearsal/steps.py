"""The vocabulary of the legs: figures of 4, 6 or 8 counts, each a list of steps onto named places.

A step lands on a count. Places are given as offsets from the neutral stance in the dancer's own frame (x to the
left, z to the front, metres), so a figure can be scaled by energy, mirrored, turned and put anywhere. Every figure
ends where it began, so that any figure may follow any other. Not from the paper, whose dance is recorded.
"""

from dataclasses import dataclass, replace

import numpy as np

LEFT, RIGHT = 0, 1
HALF_STANCE = 0.105  # metres from the midline to each ankle


@dataclass(frozen=True)
class Step:
    """One foot leaves the floor and lands on a count."""

    count: float
    side: int
    x: float = 0.0  # offset from the foot's neutral place, metres, to the dancer's left
    z: float = 0.0  # to the front
    yaw: float = 0.0  # of the foot in the dancer's frame, radians, positive to the left
    weight: float = 1.0  # share of the body it then carries: 1 a step, 0 a touch
    lift: float = 0.07  # height of the arc, metres
    pitch: float = 0.0  # of the foot on the floor: positive stands on the ball, negative on the heel
    travel: float = 0.62  # counts from lift-off to landing
    air: tuple[float, float, float, float] | None = None  # a pose in the air: count, x, height, z


@dataclass(frozen=True)
class Figure:
    """A step pattern and the way the pelvis goes with it."""

    name: str
    counts: int
    steps: tuple[Step, ...]
    metre: int = 4
    energy: tuple[float, float] = (0.0, 1.0)
    styles: tuple[str, ...] = ()  # empty: any
    bounce: float = 1.0  # times the style's bounce
    hips: float = 1.0  # times the style's hip roll
    twist: tuple[tuple[float, float], ...] = ()  # count, pelvis yaw in radians
    dip: tuple[tuple[float, float], ...] = ()  # count, metres down
    shift: tuple[
        tuple[float, float], ...
    ] = ()  # count, share of the weight on the left foot, where no step says it


def mirrored(figure: Figure) -> Figure:
    """The same figure begun with the other foot."""

    def other(step: Step) -> Step:
        air = None if step.air is None else (step.air[0], -step.air[1], step.air[2], step.air[3])
        return replace(step, side=1 - step.side, x=-step.x, yaw=-step.yaw, air=air)

    return replace(
        figure,
        steps=tuple(other(step) for step in figure.steps),
        twist=tuple((count, -yaw) for count, yaw in figure.twist),
        shift=tuple((count, 1.0 - share) for count, share in figure.shift),
    )


def first_foot(figure: Figure) -> int | None:
    """The foot that moves first; None for a figure on planted feet."""
    return min(figure.steps, key=lambda step: step.count).side if figure.steps else None


def _turned(count: float, side: int, heading: float, weight: float = 1.0, lift: float = 0.06) -> Step:
    """A step to the neutral place of a dancer who has turned by `heading` on the spot."""
    x = HALF_STANCE if side == LEFT else -HALF_STANCE
    return Step(count, side, x * (np.cos(heading) - 1.0), -x * np.sin(heading), heading, weight, lift)


def _march(lift: float, travel: float = 0.62) -> tuple[Step, ...]:
    return tuple(Step(float(c), c % 2, lift=lift, travel=travel) for c in range(8))


def _knee(count: float, side: int, height: float, forward: float) -> Step:
    inward = -0.03 if side == LEFT else 0.03
    return Step(count, side, air=(count - 1.0, inward, height, forward), travel=1.6)


L, R = LEFT, RIGHT

FIGURES: tuple[Figure, ...] = (
    Figure("bounce", 8, (), energy=(0.0, 0.45), bounce=1.1, shift=((0, 0.62), (2, 0.38), (4, 0.62), (6, 0.38))),
    Figure(
        "sway", 8,
        (Step(0, L, 0.12, lift=0.05, travel=0.9), Step(4, R, -0.12, lift=0.05, travel=0.9)),
        energy=(0.0, 0.4), styles=("ballet", "ballad", "waltz", "rest"), bounce=0.5, hips=0.7,
        shift=((1.4, 0.85), (3.0, 0.75), (5.4, 0.15), (7.0, 0.25)),
    ),
    Figure(
        "step_touch", 4,
        (Step(0, L, 0.17), Step(1, R, 0.19, 0.02, weight=0.0, lift=0.05, pitch=0.25),
         Step(2, R, -0.17), Step(3, L, -0.19, 0.02, weight=0.0, lift=0.05, pitch=0.25)),
        energy=(0.2, 0.8), twist=((0, 0.10), (2, -0.10)),
    ),
    Figure(
        "two_step", 8,
        (Step(0, L, 0.20), Step(1, R, 0.20, lift=0.05), Step(2, L, 0.40), Step(3, R, 0.42, 0.03, weight=0.0, lift=0.05, pitch=0.2),
         Step(4, R, 0.18), Step(5, L, 0.18, lift=0.05), Step(6, R, -0.04), Step(7, L, -0.04, 0.03, weight=0.0, lift=0.05, pitch=0.2)),
        energy=(0.35, 1.0), twist=((0, 0.12), (3, 0.16), (4, -0.12), (7, -0.16)),
    ),
    Figure(
        "grapevine", 8,
        (Step(0, L, 0.20), Step(1, R, 0.38, -0.25, lift=0.05, pitch=0.3), Step(2, L, 0.42), Step(3, R, 0.44, 0.02, weight=0.0, lift=0.08),
         Step(4, R, 0.20), Step(5, L, 0.02, -0.25, lift=0.05, pitch=0.3), Step(6, R, -0.04), Step(7, L, -0.06, 0.02, weight=0.0, lift=0.08)),
        energy=(0.4, 1.0), twist=((0, 0.05), (1, -0.22), (2, 0.05), (3, 0.1), (4, -0.05), (5, 0.22), (6, -0.05), (7, -0.1)),
    ),
    Figure("march", 8, _march(0.14), energy=(0.45, 1.0), twist=tuple((c, 0.10 * (-1) ** c) for c in range(8))),
    Figure(
        "knee_lifts", 8,
        (Step(0, L, 0.05), _knee(2, R, 0.25, 0.14), _knee(4, L, 0.25, 0.14), _knee(6, R, 0.25, 0.14), Step(7, L, weight=0.0, lift=0.05, pitch=0.2)),
        energy=(0.6, 1.0), twist=((0, -0.05), (1, 0.14), (3, -0.14), (5, 0.14), (7, 0.0)),
    ),
    Figure(
        "side_lunge", 8,
        (Step(0, L, 0.30, 0.04, yaw=0.2, weight=0.8, lift=0.06), Step(2, L, 0.0), Step(4, R, -0.30, 0.04, yaw=-0.2, weight=0.8, lift=0.06),
         Step(6, R, 0.0)),
        energy=(0.5, 1.0), dip=((0, 0.07), (1, 0.09), (2, 0.0), (4, 0.07), (5, 0.09), (6, 0.0)),
        twist=((0, 0.2), (2, 0.0), (4, -0.2), (6, 0.0)),
    ),
    Figure(
        "box", 8,
        (Step(0, L, 0.20), Step(1, R, 0.20, lift=0.05), Step(2, L, 0.20, 0.24), Step(3, R, 0.20, 0.22, weight=0.0, lift=0.05, pitch=0.2),
         Step(4, R, -0.02, 0.22), Step(5, L, -0.02, 0.22, lift=0.05), Step(6, R, -0.02), Step(7, L, 0.0, 0.02, weight=0.0, lift=0.05, pitch=0.2)),
        energy=(0.3, 0.9), twist=((1, 0.1), (3, -0.1), (5, -0.1), (7, 0.1)),
    ),
    Figure(
        "heel_digs", 4,
        (Step(0, L, 0.03, 0.24, yaw=0.15, weight=0.06, pitch=-0.38), Step(1, L), Step(2, R, -0.03, 0.24, yaw=-0.15, weight=0.06, pitch=-0.38),
         Step(3, R)),
        energy=(0.3, 0.9), styles=("house", "rock", "swing", "hip_hop", "drum_and_bass", "pop"), dip=((0, 0.02), (1, 0.0), (2, 0.02), (3, 0.0)),
    ),
    Figure(
        "twist", 8, (Step(0, L, 0.06, lift=0.05), Step(1, R, -0.06, lift=0.05)),
        energy=(0.35, 1.0), styles=("rock", "swing", "house", "pop", "salsa"), bounce=0.8,
        twist=((1, -0.2), (2, 0.38), (3, -0.38), (4, 0.38), (5, -0.38), (6, 0.38), (7, -0.38), (8, 0.0)),
        dip=((1, 0.0), (4, 0.08), (6, 0.08), (8, 0.0)), shift=((2, 0.65), (3, 0.35), (4, 0.65), (5, 0.35), (6, 0.65), (7, 0.4)),
    ),
    Figure(
        "kick_ball_change", 4,
        (Step(0.5, L, -0.02, -0.12, weight=0.75, pitch=0.3, travel=1.05, air=(0.0, 0.0, 0.20, 0.36)), Step(1, R, lift=0.05, travel=0.42),
         Step(2, L, 0.02, 0.12), Step(3, R, -0.02)),
        energy=(0.55, 1.0), styles=("house", "rock", "hip_hop", "pop", "swing", "drum_and_bass"),
    ),
    Figure(
        "quarter_turn", 8,
        (_turned(0, L, 0.6), _turned(1, R, 1.2), _turned(2, L, 1.2), _turned(3, R, 1.2, 0.0, 0.05),
         _turned(4, R, 0.7), _turned(5, L, 0.0), _turned(6, R, 0.0), _turned(7, L, 0.0, 0.0, 0.05)),
        energy=(0.45, 1.0),
    ),
    Figure(
        "walk", 8,
        (Step(0, L, 0.0, 0.22), Step(1, R, 0.0, 0.40), Step(2, L, 0.0, 0.56), Step(3, R, 0.0, 0.60, weight=0.0, lift=0.05, pitch=0.2),
         Step(4, R, 0.0, 0.36, pitch=0.0), Step(5, L, 0.0, 0.18), Step(6, R, 0.0, -0.02), Step(7, L, 0.0, 0.02, weight=0.0, lift=0.05, pitch=0.2)),
        energy=(0.35, 1.0), twist=((0, -0.12), (1, 0.12), (2, -0.12), (3, 0.1), (4, 0.12), (5, -0.12), (6, 0.12), (7, 0.0)),
    ),
    Figure(
        "mambo", 4,
        (Step(0, L, 0.0, 0.20, lift=0.05, travel=0.42), Step(0.5, R, lift=0.045, travel=0.36), Step(1, L, lift=0.05, travel=0.42),
         Step(2, R, 0.0, -0.20, lift=0.05, pitch=0.25, travel=0.42), Step(2.5, L, lift=0.045, travel=0.36), Step(3, R, lift=0.05, travel=0.42)),
        energy=(0.3, 1.0), styles=("salsa",), bounce=0.4, hips=2.0,
        twist=((0, -0.16), (0.5, 0.14), (1, -0.16), (2, 0.16), (2.5, -0.14), (3, 0.16)),
    ),
    Figure(
        "charleston", 4,
        (Step(0, L, 0.0, 0.14), Step(2, R, 0.0, -0.10, travel=1.6, air=(1.0, 0.02, 0.20, 0.38)), Step(3, L, 0.0, -0.26, weight=0.0, pitch=0.35, lift=0.09)),
        energy=(0.4, 1.0), styles=("swing", "rock", "drum_and_bass"), twist=((0, 0.1), (1, -0.12), (2, -0.1), (3, 0.12)),
    ),
    Figure(
        "waltz_box", 6,
        (Step(0, L, 0.0, 0.20, lift=0.05), Step(1, R, -0.12, 0.20, lift=0.06), Step(2, L, -0.12, 0.20, lift=0.045),
         Step(3, R, -0.12, 0.0, lift=0.05, pitch=0.2), Step(4, L, 0.0, 0.0, lift=0.06), Step(5, R, 0.0, 0.0, lift=0.045)),
        metre=3, energy=(0.35, 1.0), twist=((0, -0.12), (2, 0.0), (3, 0.12), (5, 0.0)),
    ),
    Figure(
        "waltz_balance", 6,
        (Step(0, L, 0.16, lift=0.06), Step(1, R, 0.16, -0.06, weight=0.25, lift=0.05, pitch=0.3),
         Step(3, R, -0.16, lift=0.06), Step(4, L, -0.16, -0.06, weight=0.25, lift=0.05, pitch=0.3)),
        metre=3, energy=(0.0, 0.8), twist=((0, 0.12), (3, -0.12)),
    ),
    Figure(
        "waltz_turn", 6,
        (_turned(0, L, 0.45), _turned(1, R, 0.7), _turned(2, L, 0.7, lift=0.045), _turned(3, R, 0.25), _turned(4, L, 0.0), _turned(5, R, 0.0, lift=0.045)),
        metre=3, energy=(0.4, 1.0),
    ),
    Figure(
        "tendu", 8,
        (Step(1, L, 0.26, 0.02, yaw=0.35, weight=0.05, lift=0.04, pitch=0.5, travel=0.9), Step(2.6, L, 0.02, lift=0.04, travel=0.9),
         Step(5, R, -0.26, 0.02, yaw=-0.35, weight=0.05, lift=0.04, pitch=0.5, travel=0.9), Step(6.6, R, -0.02, lift=0.04, travel=0.9)),
        energy=(0.0, 1.0), styles=("ballet",), bounce=0.6, hips=0.4, dip=((0, 0.03), (1, 0.0), (2.6, 0.0), (4, 0.03), (5, 0.0), (7, 0.0)),
    ),
    Figure(
        "degage", 8,
        (Step(2, L, 0.10, 0.14, yaw=0.2, travel=1.7, lift=0.06, air=(1.0, 0.22, 0.18, 0.42)), Step(4, L, 0.0, 0.0, travel=0.9, lift=0.05),
         Step(6, R, -0.10, 0.14, yaw=-0.2, travel=1.7, lift=0.06, air=(5.0, -0.22, 0.18, 0.42)), Step(7.4, R, 0.0, 0.0, travel=0.8, lift=0.05)),
        energy=(0.35, 1.0), styles=("ballet",), bounce=0.5, hips=0.4,
    ),
)  # fmt: skip
FIGURE = {figure.name: figure for figure in FIGURES}


def fitting(style: str, metre: int, energy: float) -> list[Figure]:
    """The figures a style, metre and energy allow; never empty."""
    kind = [f for f in FIGURES if f.metre == metre or (metre == 3 and f.name == "sway" and energy < 0.3)]
    kind = [f for f in kind if not f.styles or style in f.styles]
    if style == "ballet":
        kind = [FIGURE["sway"], FIGURE["tendu"], FIGURE["degage"]]
    if style == "rest":
        kind = [FIGURE["sway"]]
    near = [f for f in kind if f.energy[0] <= energy <= f.energy[1]]
    if near:
        return near
    return [min(kind, key=lambda f: abs(energy - (f.energy[0] + f.energy[1]) / 2))]
