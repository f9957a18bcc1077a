"""Krippendorff's alpha: agreement of raters beyond chance, even if not every rater judged every unit.

alpha = 1 - D_o / D_e from the coincidence matrix (Krippendorff, *Content Analysis*, 2004, ch. 11). 1 is full agreement,
0 what chance would give.
"""

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

Metric = Literal["nominal", "ordinal", "interval"]


def alpha(units: Iterable[Sequence[float]], metric: Metric) -> float | None:
    """Alpha over units (the things judged), each with the values that its raters gave.

    None if fewer than two values can be paired or all values are equal: then chance would agree, too.
    """
    pairable = [values for values in units if len(values) > 1]
    levels = sorted({value for values in pairable for value in values})
    if len(levels) < 2:
        return None
    place = {value: at for at, value in enumerate(levels)}
    together = np.zeros((len(levels), len(levels)))
    for values in pairable:
        counts = np.bincount([place[value] for value in values], minlength=len(levels)).astype(float)
        together += (np.outer(counts, counts) - np.diag(counts)) / (len(values) - 1)
    totals = together.sum(1)
    apart = _apart(np.array(levels, float), totals, metric)
    by_chance = (np.outer(totals, totals) - np.diag(totals)) / (totals.sum() - 1)
    expected = float((by_chance * apart).sum())
    return 1 - float((together * apart).sum()) / expected if expected > 0 else None


def _apart(
    levels: Float[np.ndarray, " v"], totals: Float[np.ndarray, " v"], metric: Metric
) -> Float[np.ndarray, "v v"]:
    """Squared differences between all values, under the metric."""
    if metric == "nominal":
        return 1 - np.eye(len(levels))
    if metric == "interval":
        return np.asarray((levels[:, None] - levels[None]) ** 2)
    below = np.cumsum(totals) - totals / 2  # ordinal: the count of values in between, with half of each end
    return np.asarray((below[:, None] - below[None]) ** 2)
