"""What every beat score has in common: how near the nearest beat is (paper, appendix Beat Alignment, GAHR).

    hit rate = mean over events e of exp(-min_b (e - b)^2 / 2 sigma^2)

Dimensionless, 0 to 1. Whether audio events look for motion beats or motion beats for audio events is the caller's
choice of what goes in as `events`, and the published forms differ in it: see `gesture_alignment`, `dance_alignment`.
A score says nothing alone, because frequent beats are near everything: put the `chance` level beside it.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Shaped

SHARP_SIGMA_S = 0.06
"""Tolerance of our own `sharp` forms, seconds: with the usual 0.3 s any lively motion scores near 1."""


def hit_rate(events: Shaped[np.ndarray, " n"], beats: Shaped[np.ndarray, " m"], sigma: float) -> float:
    """Mean hit of the events by the nearest beat, all in the unit of `sigma`; 0 without beats, NaN without events."""
    if not len(events):
        return float("nan")
    if not len(beats):
        return 0.0
    distance = np.abs(np.asarray(events, np.float64)[:, None] - np.asarray(beats, np.float64)[None]).min(1)
    return float(np.exp(-(distance**2) / (2 * sigma**2)).mean())


def mean_hit_rate(
    events: Shaped[np.ndarray, " n"], beats: Sequence[Shaped[np.ndarray, " m"]], sigma: float
) -> float:
    """`hit_rate` averaged over joints that each have beats of their own; a joint without beats counts as 0."""
    return float(np.mean([hit_rate(events, own, sigma) for own in beats]))


def overlapping(events: Float[np.ndarray, " n"], own: Float[np.ndarray, " m"]) -> Float[np.ndarray, " k"]:
    """Another clip's events that fall inside the stretch where ours lie; none where there are none of ours."""
    if not len(own):
        return np.asarray(events[:0])
    return np.asarray(events[(events >= own.min()) & (events <= own.max())])
