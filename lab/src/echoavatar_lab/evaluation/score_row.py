"""A row of the research bench's table: a value, its interval, chance level and truth; as text and as JSON."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .metrics.bootstrap import UNKNOWN, Interval, mean_interval

NAN = float("nan")


class Row(NamedTuple):
    """One metric.

    Attributes:
        name: as in docs/metrics.md.
        unit: of the values; empty for a pure number.
        value: score of the generated motion.
        interval: its 95 % interval over clips.
        chance: score of motion with other clips' audio (or of guessing); NaN if there is no such thing.
        excess: value - chance, paired clip by clip.
        excess_interval: the 95 % interval of the excess.
        truth: score of the true motion; for FID, one half of the truth against the other.
        truth_chance: the true motion's own chance level.
    """

    name: str
    unit: str
    value: float
    interval: Interval = UNKNOWN
    chance: float = NAN
    excess: float = NAN
    excess_interval: Interval = UNKNOWN
    truth: float = NAN
    truth_chance: float = NAN


def row_of_means(
    name: str,
    unit: str,
    values: Float[np.ndarray, " n"],
    *,
    truths: Float[np.ndarray, " n"] | None = None,
    chances: Float[np.ndarray, " n"] | None = None,
    truth_chances: Float[np.ndarray, " n"] | None = None,
    weights: Float[np.ndarray, " n"] | None = None,
    seed: int = 0,
) -> Row:
    """A metric that is a (weighted) mean over clips; NaN marks clips without a value."""
    row = Row(name, unit, _mean(values, weights), mean_interval(values, weights, seed=seed))
    if truths is not None:
        row = row._replace(truth=_mean(truths, weights))
    if truth_chances is not None:
        row = row._replace(truth_chance=_mean(truth_chances, weights))
    if chances is not None:
        over = values - chances
        row = row._replace(
            chance=_mean(chances, weights),
            excess=_mean(over, weights),
            excess_interval=mean_interval(over, weights, seed=seed),
        )
    return row


def as_text(rows: Sequence[Row]) -> str:
    """Aligned columns; a dash for missing values."""
    head = ("metric", "made", "95 % interval", "chance", "over chance", "95 % interval", "truth", "its chance", "unit")
    lines = [head]
    for row in rows:
        lines.append(
            (
                row.name,
                _number(row.value),
                _span(row.interval),
                _number(row.chance),
                _number(row.excess, sign=True),
                _span(row.excess_interval),
                _number(row.truth),
                _number(row.truth_chance),
                row.unit,
            )
        )
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    flush_left = (0, len(head) - 1)
    text = [
        "  ".join(
            cell.ljust(width) if k in flush_left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    ]
    return "\n".join(text)


def as_json(rows: Sequence[Row]) -> dict[str, dict[str, object]]:
    """By name; null for missing values."""
    return {
        row.name: {
            "unit": row.unit,
            "value": _plain(row.value),
            "interval": [_plain(x) for x in row.interval],
            "chance": _plain(row.chance),
            "over_chance": _plain(row.excess),
            "over_chance_interval": [_plain(x) for x in row.excess_interval],
            "truth": _plain(row.truth),
            "truth_chance": _plain(row.truth_chance),
        }
        for row in rows
    }


def _mean(values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"] | None) -> float:
    known = np.isfinite(values)
    if not known.any():
        return NAN
    chosen = None if weights is None else weights[known]
    return float(np.average(values[known], weights=chosen if chosen is not None and chosen.sum() > 0 else None))


def _plain(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _number(value: float, *, sign: bool = False) -> str:
    if not math.isfinite(value):
        return "-"
    digits = 1 if abs(value) >= 100 else 3 if abs(value) >= 0.01 or abs(value) < 5e-6 else 5
    return f"{value:{'+' if sign else ''}.{digits}f}"


def _span(ends: Interval) -> str:
    return f"{_number(ends.low)} to {_number(ends.high)}" if math.isfinite(ends.low) else "-"
