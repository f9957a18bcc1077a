"""The manner of a speaker: a few numbers that condition the generator (not in the paper).

The sound does not say which hand a speaker uses, nor how lively he is. Without a manner each chunk draws what most
people do, and both hands do the same. A session draws a manner from its seed; a user may set parts of it.

A speaker's manner alone is an average over minutes, which a chunk cannot follow: it says that a hand often rests, not
that it rests now. So the generator also gets how busy each hand is in these seconds (`HANDS`), and how
high (`HEIGHTS`).

All numbers except the heights enter as one vector, added to the backbone's input at each frame (`MannerControl`). From
there a generator does not learn to tell left from right: the past says where the hands are, and in windows without a
past the vector is small beside the noise. So the heights enter where a code is drawn: they raise the logits of the
first-layer codes of the upper body that have the hands there, times a learned gate. NaN adds nothing.
"""

from dataclasses import astuple, dataclass, fields

import numpy as np
from jaxtyping import Float

KNOTS = 5  # of the piecewise linear function of each number
_KNOTS = np.linspace(0, 1, KNOTS, dtype=np.float32)


@dataclass(frozen=True)
class Manner:
    """How one person gestures; every value is between 0 and 1, and 0.5 is nothing special.

    Attributes:
        liveliness: 0 is few, small and slow gestures on a quiet body; 1 is a storyteller.
        right: which hand leads; the chance that a gesture of one hand is the right hand's.
        both: chance that both hands work in a phrase; otherwise one works, or they take turns.
        mirror: how much two working hands share; 0: each its own way, size and time, 1: nearly mirror images.
        space: where gestures are; 0 is low, narrow and near the body, 1 high and wide.
        hold: 0: hands keep moving, and sink at once after a phrase; 1: they stay up, with small moves.
        bow: how far the trunk bends forwards as the hands sink; upright at 0.
        tilt: how far the shoulder of a raised hand rises; level at 0.
        rest: where idle hands are: below 0.55 at the sides, then clasped (0.75), on the hip (0.9), behind the back.
    """

    liveliness: float = 0.5
    right: float = 0.7
    both: float = 0.5
    mirror: float = 0.25
    space: float = 0.5
    hold: float = 0.5
    bow: float = 0.5
    tilt: float = 0.5
    rest: float = 0.0

    @property
    def values(self) -> tuple[float, ...]:
        """The numbers in the order of `MANNER`."""
        return astuple(self)


MANNER = tuple(field.name for field in fields(Manner))
HANDS = ("left_hand", "right_hand")  # how busy each is now: `busy` of its mean speed over `BUSY_S` around a frame
HEIGHTS = ("left_height", "right_height")  # how high each is: `raised` of its mean height over `HIGH_S`
TOLD = MANNER + HANDS + HEIGHTS  # the numbers that a generator gets, in order
BUSY_S, HIGH_S = 2.0, 1.2
_HALF_BUSY = 0.6  # arm lengths per second


def busy(speed: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """How busy a hand of this mean speed (arm lengths per second) is: 0 at rest, 0.5 at a talker's mean, below 1."""
    return speed / (speed + _HALF_BUSY)


def raised(height: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """How raised a wrist at this height over the shoulders (arm lengths) is: 0 where it hangs, 1 at the chin."""
    return np.clip((height + 1.0) / 1.2, 0, 1)


def draw_manner(seed: int) -> Manner:
    """The manner that follows from a seed; three people in four lead with the right hand."""
    rng = np.random.default_rng([seed, 1])
    right = float(rng.beta(4, 2))
    return Manner(
        liveliness=float(rng.beta(2, 2)),
        right=1 - right if rng.random() < 0.1 else right,
        both=float(rng.beta(2, 2)),
        mirror=float(rng.beta(1.2, 4)),
        space=float(rng.beta(2, 2)),
        hold=float(rng.beta(2, 2)),
        bow=float(rng.random()),
        tilt=float(rng.random()),
        rest=float(rng.random()),
    )


def near_knots(told: Float[np.ndarray, "b m"]) -> Float[np.ndarray, "b n"]:
    """How near each number is to each knot, between 0 and 1; 0 for NaN."""
    near = np.fmax(1 - np.abs(told[..., None] - _KNOTS) * np.float32(KNOTS - 1), 0)
    return near.reshape(len(told), -1)
