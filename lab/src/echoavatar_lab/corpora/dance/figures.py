"""The step figures of the dance, in the notation of `steps.parse_steps`."""

from dataclasses import replace

import numpy as np

from .steps import HALF_STANCE, LEFT, Figure, Step, parse_pairs, parse_steps


def _turning(text: str) -> tuple[Step, ...]:
    """Steps on the spot: each foot to its neutral place after the dancer has turned by the step's yaw."""

    def placed(step: Step) -> Step:
        x = HALF_STANCE if step.side == LEFT else -HALF_STANCE
        return replace(step, x=x * (np.cos(step.yaw) - 1.0), z=-x * np.sin(step.yaw), lift=0.055)

    return tuple(placed(step) for step in parse_steps(text))


FIGURES: tuple[Figure, ...] = (
    Figure("bounce", 8, (), energy=(0.0, 0.45), bounce=1.1, shift=parse_pairs("0 .62, 2 .38, 4 .62, 6 .38")),
    Figure(
        "sway",
        8,
        parse_steps("0 L x.12 l.05 t.9; 4 R x-.12 l.05 t.9"),
        energy=(0.0, 0.4),
        styles=("ballet", "ballad", "waltz", "rest"),
        bounce=0.5,
        hips=0.7,
        shift=parse_pairs("1.4 .85, 3 .75, 5.4 .15, 7 .25"),
    ),
    Figure(
        "step_touch",
        4,
        parse_steps("0 L x.17; 1 R x.19 z.02 w0 l.05 p.25; 2 R x-.17; 3 L x-.19 z.02 w0 l.05 p.25"),
        energy=(0.2, 0.8),
        twist=parse_pairs("0 .1, 2 -.1"),
    ),
    Figure(
        "two_step",
        8,
        parse_steps(
            "0 L x.2; 1 R x.2 l.05; 2 L x.4; 3 R x.42 z.03 w0 l.05 p.2; 4 R x.18; 5 L x.18 l.05; "
            "6 R x-.04; 7 L x-.04 z.03 w0 l.05 p.2"
        ),
        energy=(0.35, 1.0),
        twist=parse_pairs("0 .12, 3 .16, 4 -.12, 7 -.16"),
    ),
    Figure(
        "grapevine",
        8,
        parse_steps(
            "0 L x.2; 1 R x.38 z-.25 l.05 p.3; 2 L x.42; 3 R x.44 z.02 w0 l.08; 4 R x.2; "
            "5 L x.02 z-.25 l.05 p.3; 6 R x-.04; 7 L x-.06 z.02 w0 l.08"
        ),
        energy=(0.4, 1.0),
        twist=parse_pairs("0 .05, 1 -.22, 2 .05, 3 .1, 4 -.05, 5 .22, 6 -.05, 7 -.1"),
    ),
    Figure(
        "march",
        8,
        parse_steps("0 L l.14; 1 R l.14; 2 L l.14; 3 R l.14; 4 L l.14; 5 R l.14; 6 L l.14; 7 R l.14"),
        energy=(0.45, 1.0),
        twist=parse_pairs("0 .1, 1 -.1, 2 .1, 3 -.1, 4 .1, 5 -.1, 6 .1, 7 -.1"),
    ),
    Figure(
        "knee_lifts",
        8,
        parse_steps(
            "0 L x.05; 2 R t1.6 air:1/.03/.25/.14; 4 L t1.6 air:3/-.03/.25/.14; "
            "6 R t1.6 air:5/.03/.25/.14; 7 L w0 l.05 p.2"
        ),
        energy=(0.6, 1.0),
        twist=parse_pairs("0 -.05, 1 .14, 3 -.14, 5 .14, 7 0"),
    ),
    Figure(
        "side_lunge",
        8,
        parse_steps("0 L x.3 z.04 y.2 w.8 l.06; 2 L; 4 R x-.3 z.04 y-.2 w.8 l.06; 6 R"),
        energy=(0.5, 1.0),
        twist=parse_pairs("0 .2, 2 0, 4 -.2, 6 0"),
        dip=parse_pairs("0 .07, 1 .09, 2 0, 4 .07, 5 .09, 6 0"),
    ),
    Figure(
        "box",
        8,
        parse_steps(
            "0 L x.2; 1 R x.2 l.05; 2 L x.2 z.24; 3 R x.2 z.22 w0 l.05 p.2; 4 R x-.02 z.22; "
            "5 L x-.02 z.22 l.05; 6 R x-.02; 7 L z.02 w0 l.05 p.2"
        ),
        energy=(0.3, 0.9),
        twist=parse_pairs("1 .1, 3 -.1, 5 -.1, 7 .1"),
    ),
    Figure(
        "heel_digs",
        4,
        parse_steps("0 L x.03 z.24 y.15 w.06 p-.38; 1 L; 2 R x-.03 z.24 y-.15 w.06 p-.38; 3 R"),
        energy=(0.3, 0.9),
        styles=("house", "rock", "swing", "hip_hop", "drum_and_bass", "pop"),
        dip=parse_pairs("0 .02, 1 0, 2 .02, 3 0"),
    ),
    Figure(
        "twist",
        8,
        parse_steps("0 L x.06 l.05; 1 R x-.06 l.05"),
        energy=(0.35, 1.0),
        styles=("rock", "swing", "house", "pop", "salsa"),
        bounce=0.8,
        twist=parse_pairs("1 -.2, 2 .38, 3 -.38, 4 .38, 5 -.38, 6 .38, 7 -.38, 8 0"),
        dip=parse_pairs("1 0, 4 .08, 6 .08, 8 0"),
        shift=parse_pairs("2 .65, 3 .35, 4 .65, 5 .35, 6 .65, 7 .4"),
    ),
    Figure(
        "kick_ball_change",
        4,
        parse_steps(".5 L x-.02 z-.12 w.75 p.3 t1.05 air:0/0/.17/.32; 1 R l.05 t.42; 2 L x.02 z.12; 3 R x-.02"),
        energy=(0.55, 1.0),
        styles=("house", "rock", "hip_hop", "pop", "swing", "drum_and_bass"),
    ),
    Figure(
        "quarter_turn",
        8,
        _turning("0 L y.6; 1 R y1.2; 2 L y1.2; 3 R y1.2 w0; 4 R y.7; 5 L; 6 R; 7 L w0"),
        energy=(0.45, 1.0),
    ),
    Figure(
        "walk",
        8,
        parse_steps(
            "0 L z.22; 1 R z.4; 2 L z.56; 3 R z.6 w0 l.05 p.2; 4 R z.36; 5 L z.18; 6 R z-.02; 7 L z.02 w0 l.05 p.2"
        ),
        energy=(0.35, 1.0),
        twist=parse_pairs("0 -.12, 1 .12, 2 -.12, 3 .1, 4 .12, 5 -.12, 6 .12, 7 0"),
    ),
    Figure(
        "mambo",
        4,
        parse_steps(
            "0 L z.2 l.05 t.42; .5 R l.045 t.36; 1 L l.05 t.42; 2 R z-.2 l.05 p.25 t.42; "
            "2.5 L l.045 t.36; 3 R l.05 t.42"
        ),
        energy=(0.3, 1.0),
        styles=("salsa",),
        bounce=0.4,
        hips=2.0,
        twist=parse_pairs("0 -.16, .5 .14, 1 -.16, 2 .16, 2.5 -.14, 3 .16"),
    ),
    Figure(
        "charleston",
        4,
        parse_steps("0 L z.14; 2 R z-.1 t1.6 air:1/.02/.17/.32; 3 L z-.26 w0 l.09 p.35"),
        energy=(0.4, 1.0),
        styles=("swing", "rock", "drum_and_bass"),
        twist=parse_pairs("0 .1, 1 -.12, 2 -.1, 3 .12"),
    ),
    Figure(
        "waltz_box",
        6,
        parse_steps("0 L z.2 l.05; 1 R x-.12 z.2 l.06; 2 L x-.12 z.2 l.045; 3 R x-.12 l.05 p.2; 4 L l.06; 5 R l.045"),
        metre=3,
        energy=(0.35, 1.0),
        twist=parse_pairs("0 -.12, 2 0, 3 .12, 5 0"),
    ),
    Figure(
        "waltz_balance",
        6,
        parse_steps("0 L x.16 l.06; 1 R x.16 z-.06 w.25 l.05 p.3; 3 R x-.16 l.06; 4 L x-.16 z-.06 w.25 l.05 p.3"),
        metre=3,
        energy=(0.0, 0.8),
        twist=parse_pairs("0 .12, 3 -.12"),
    ),
    Figure("waltz_turn", 6, _turning("0 L y.45; 1 R y.7; 2 L y.7; 3 R y.25; 4 L; 5 R"), metre=3, energy=(0.4, 1.0)),
    Figure(
        "tendu",
        8,
        parse_steps(
            "1 L x.26 z.02 y.35 w.05 l.04 p.5 t.9; 2.6 L x.02 l.04 t.9; "
            "5 R x-.26 z.02 y-.35 w.05 l.04 p.5 t.9; 6.6 R x-.02 l.04 t.9"
        ),
        styles=("ballet",),
        bounce=0.6,
        hips=0.4,
        dip=parse_pairs("0 .03, 1 0, 2.6 0, 4 .03, 5 0, 7 0"),
    ),
    Figure(
        "degage",
        8,
        parse_steps(
            "2 L x.1 z.14 y.2 l.06 t1.7 air:1/.2/.16/.36; 4 L l.05 t.9; "
            "6 R x-.1 z.14 y-.2 l.06 t1.7 air:5/-.2/.16/.36; 7.4 R l.05 t.8"
        ),
        energy=(0.35, 1.0),
        styles=("ballet",),
        bounce=0.5,
        hips=0.4,
    ),
)
FIGURE = {figure.name: figure for figure in FIGURES}


def fitting(style: str, metre: int, energy: float) -> list[Figure]:
    """The figures that fit a style, metre and energy; never empty."""
    kind = [f for f in FIGURES if f.metre == metre or (metre == 3 and f.name == "sway" and energy < 0.3)]
    kind = [f for f in kind if not f.styles or style in f.styles]
    if style == "ballet":
        kind = [FIGURE["sway"], FIGURE["tendu"], FIGURE["degage"]]
    if style == "rest":
        kind = [FIGURE["sway"]]
    near = [f for f in kind if f.energy[0] <= energy <= f.energy[1]]
    return near or [min(kind, key=lambda f: abs(energy - (f.energy[0] + f.energy[1]) / 2))]
