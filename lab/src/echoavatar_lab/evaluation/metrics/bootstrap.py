"""Confidence intervals (95 %) by resampling whole clips with replacement, seeded.

Clips are the independent samples. Frames of one clip resemble each other, so resampling frames would make intervals far
too narrow. With fewer than two clips there is no interval (NaN).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

LEVEL = 0.95
SAMPLES = 2000


class Interval(NamedTuple):
    """Lower and upper end; NaN if there are too few clips."""

    low: float
    high: float


UNKNOWN = Interval(float("nan"), float("nan"))


def mean_interval(
    values: Float[np.ndarray, " n"],
    weights: Float[np.ndarray, " n"] | None = None,
    *,
    samples: int = SAMPLES,
    seed: int = 0,
) -> Interval:
    """Interval of the (weighted) mean over clips; clips without a value (NaN) are left out."""
    known = np.isfinite(values)
    values, weights = values[known], np.ones(known.sum()) if weights is None else weights[known]
    if len(values) < 2:
        return UNKNOWN
    draws = np.random.default_rng(seed).integers(len(values), size=(samples, len(values)))
    total = np.maximum(weights[draws].sum(1), 1e-300)
    return _between((values[draws] * weights[draws]).sum(1) / total)


def interval(
    statistic: Callable[[Int[np.ndarray, " n"]], float],
    clips: int,
    *,
    is_centred: bool = False,
    samples: int = SAMPLES,
    seed: int = 0,
) -> Interval:
    """Interval of any statistic of a selection of clips, which are given by number.

    Args:
        statistic: value for the clips with these numbers, repetitions included.
        clips: number of clips.
        is_centred: shift the interval so that its median is the value of all clips. Use it for distances between
            distributions: a resample lies farther from everything than the whole does, so that the plain interval
            would not even contain the value.
        samples: number of resamples.
        seed: of the resampling.
    """
    if clips < 2:
        return UNKNOWN
    draws = np.random.default_rng(seed).integers(clips, size=(samples, clips))
    values = np.array([statistic(draw) for draw in draws])
    shift = statistic(np.arange(clips)) - float(np.median(values)) if is_centred else 0.0
    return _between(values + shift)


def _between(values: Float[np.ndarray, " n"]) -> Interval:
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Interval(float(low), float(high))
