"""How sure a number is: 95 % intervals by resampling whole clips with replacement, seeded.

Clips are what was drawn from the world, not frames: frames of one clip resemble each other, and resampling them would
make intervals far too narrow. With fewer than two clips there is no interval (NaN).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

LEVEL = 0.95
SAMPLES = 2000


class Interval(NamedTuple):
    """Low and high end; NaN where there are too few clips to tell."""

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
    """Interval of anything that can be computed from a choice of clips, given as their numbers.

    Args:
        statistic: value for clips of these numbers, repetitions included.
        clips: how many there are.
        is_centred: shift the interval so that its middle is the value of all clips. For distances between
            distributions: every resample lies farther from everything than the whole, by about what the whole itself
            lies too far, so that the plain interval would not even hold the value.
        samples: how many resamples.
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
