"""The common part of all beat scores: distance to the nearest beat (paper, appendix Beat Alignment, GAHR).

    hit rate = mean over events e of exp(-min_b (e - b)^2 / 2 sigma^2)

Dimensionless, 0 to 1. The published forms differ in whether audio events look for motion beats or the reverse; the
caller decides by what it passes as `events` (`gesture_alignment`, `dance_alignment`). A score means nothing alone,
because frequent beats are near everything: report it with its `chance` level.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Shaped

SHARP_SIGMA_S = 0.06
"""Tolerance of our own `sharp` forms in seconds. With the usual 0.3 s any lively motion scores near 1."""


def hits(events: Shaped[np.ndarray, " n"], beats: Shaped[np.ndarray, " m"], sigma: float) -> Float[np.ndarray, " n"]:
    """Hit of each event by the nearest beat: 1 at the beat, 0 far from it or without beats."""
    if not len(beats):
        return np.zeros(len(events))
    distance = np.abs(np.asarray(events, np.float64)[:, None] - np.asarray(beats, np.float64)[None]).min(1)
    return np.asarray(np.exp(-(distance**2) / (2 * sigma**2)))


def hit_rate(events: Shaped[np.ndarray, " n"], beats: Shaped[np.ndarray, " m"], sigma: float) -> float:
    """Mean hit of each event by the nearest beat, all in the unit of `sigma`; 0 without beats, NaN without events."""
    if not len(events):
        return float("nan")
    return float(hits(events, beats, sigma).mean())


def mean_hit_rate(events: Shaped[np.ndarray, " n"], beats: Sequence[Shaped[np.ndarray, " _"]], sigma: float) -> float:
    """`hit_rate` averaged over joints with their own beats; a joint without beats counts as 0."""
    return float(np.mean([hit_rate(events, own, sigma) for own in beats]))


def overlapping(events: Float[np.ndarray, " n"], own: Float[np.ndarray, " m"]) -> Float[np.ndarray, " k"]:
    """Another clip's events that lie between the first and the last of `own`; none if `own` is empty."""
    if not len(own):
        return np.asarray(events[:0])
    return np.asarray(events[(events >= own.min()) & (events <= own.max())])
