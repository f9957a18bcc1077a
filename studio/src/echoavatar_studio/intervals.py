"""Means with 95 % intervals (paper, Subjective Evaluation Protocol: mean and interval of ratings in [-2, 2]).

`half` is Student's interval over single judgements, as in the paper. Judgements of one rater are not independent, so
`half_raters` takes each rater's mean as one observation; trust it if raters differ.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from scipy import stats

from .wire_owner import Mean

LEVEL = 0.95


def mean_of(values: Sequence[float], raters: Sequence[int]) -> Mean:
    """The mean of ratings and its intervals, given the rater of each. Half-widths need two observations."""
    by_rater: dict[int, list[float]] = defaultdict(list)
    for value, rater in zip(values, raters, strict=True):
        by_rater[rater].append(value)
    return Mean(
        mean=float(np.mean(values)) if values else 0.0,
        half=half_width(values),
        half_raters=half_width([float(np.mean(own)) for own in by_rater.values()]),
        count=len(values),
    )


def half_width(values: Sequence[float]) -> float | None:
    """Half of Student's 95 % interval of a mean: t s / sqrt(n)."""
    if len(values) < 2:
        return None
    spread = float(np.std(values, ddof=1))
    return float(stats.t.ppf((1 + LEVEL) / 2, len(values) - 1) * spread / np.sqrt(len(values)))
