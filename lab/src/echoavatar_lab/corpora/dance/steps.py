"""Steps and step figures of the dance: figures of 4, 6 or 8 counts, each a list of steps.

A step lands on a count. Positions are offsets from the neutral stance in the dancer's axes (x to the left, z to the
front, metres), so a figure can be scaled by energy, mirrored and turned. Every figure ends where it began, so any
figure may follow any other. Not in the paper, whose dance is recorded.
"""

from dataclasses import dataclass, replace

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
    weight: float = 1.0  # share of the body's weight on the foot after landing: 1 a step, 0 a touch
    lift: float = 0.07  # height of the arc, metres
    pitch: float = 0.0  # of the foot on the floor: positive stands on the ball, negative on the heel
    travel: float = 0.62  # counts from lift-off to landing
    air: tuple[float, float, float, float] | None = None  # way point in the air: count, x, height, z


@dataclass(frozen=True)
class Figure:
    """A step pattern with its pelvis motion."""

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
    shift: tuple[tuple[float, float], ...] = ()  # count, share of the weight on the left foot between steps


def mirrored(figure: Figure) -> Figure:
    """The same figure, begun with the other foot."""

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


def parse_steps(text: str) -> tuple[Step, ...]:
    """Parse steps, separated by `;`: count, foot L or R, then the fields that differ from a plain step.

    x, z, y(aw), w(eight), l(ift), p(itch), t(ravel) with a number, and `air:count/x/height/z`.
    """
    names = {"x": "x", "z": "z", "y": "yaw", "w": "weight", "l": "lift", "p": "pitch", "t": "travel"}
    steps = []
    for item in text.split(";"):
        count, foot, *rest = item.split()
        step = Step(float(count), "LR".index(foot))
        for word in rest:
            if word.startswith("air:"):
                at, x, height, z = (float(number) for number in word[4:].split("/"))
                step = replace(step, air=(at, x, height, z))
            else:
                step = Step(**{**vars(step), names[word[0]]: float(word[1:])})
        steps.append(step)
    return tuple(steps)


def parse_pairs(text: str) -> tuple[tuple[float, float], ...]:
    """Parse pairs of count and value, separated by `,`."""
    return tuple((float(count), float(value)) for count, value in (item.split() for item in text.split(",")))
