"""The table of scores: rows with value, interval, chance level and truth; as text, as JSON, as a picture.

Intervals are confidence intervals (95 %) by resampling whole clips with replacement, seeded. Clips are the independent
samples. Frames of one clip resemble each other, so resampling frames would make intervals far too narrow. With fewer
than two clips there is no interval (NaN).
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .paid_for import LEGEND, marked

LEVEL = 0.95
SAMPLES = 2000
NAN = float("nan")
_MADE, _TRUTH, _CHANCE = "#1f5fa8", "#2e2e2e", "#b5432a"


class Interval(NamedTuple):
    """Lower and upper end; NaN if there are too few clips."""

    low: float
    high: float


UNKNOWN = Interval(NAN, NAN)


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


class Row(NamedTuple):
    """One metric."""

    name: str  # as in docs/metrics.md
    unit: str  # of the values; empty for a pure number
    value: float  # score of the generated motion
    interval: Interval = UNKNOWN  # its 95 % interval over clips
    chance: float = NAN  # score of motion with other clips' audio (or of guessing); NaN if there is no such thing
    excess: float = NAN  # value - chance, paired clip by clip
    excess_interval: Interval = UNKNOWN  # the 95 % interval of the excess
    truth: float = NAN  # score of the true motion; for FID, one half of the truth against the other
    truth_chance: float = NAN  # the true motion's own chance level


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
    row = Row(name, unit, weighted_mean(values, weights), mean_interval(values, weights, seed=seed))
    if truths is not None:
        row = row._replace(truth=weighted_mean(truths, weights))
    if truth_chances is not None:
        row = row._replace(truth_chance=weighted_mean(truth_chances, weights))
    if chances is not None:
        over = values - chances
        row = row._replace(
            chance=weighted_mean(chances, weights),
            excess=weighted_mean(over, weights),
            excess_interval=mean_interval(over, weights, seed=seed),
        )
    return row


def mean_rows(tables: Sequence[Sequence[Row]]) -> list[Row]:
    """Tables of the same rows as one: means of all values, and of the ends of intervals."""
    found = []
    for rows in zip(*tables, strict=True):
        means = [np.mean(column, axis=0) for column in zip(*(row[2:] for row in rows), strict=True)]
        found.append(Row(*rows[0][:2], *(Interval(*mean.tolist()) if mean.ndim else float(mean) for mean in means)))
    return found


def as_text(rows: Sequence[Row]) -> str:
    """The rows in aligned columns; a dash for missing values."""
    head = ("metric", "made", "95 % interval", "chance", "over chance", "95 % interval", "truth", "its chance", "unit")
    lines = [head]
    for row in rows:
        lines.append(
            (
                marked(row.name),
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
    return "\n".join([*text, *([LEGEND] if any(marked(row.name) != row.name for row in rows) else ())])


def as_json(rows: Sequence[Row]) -> dict[str, dict[str, object]]:
    """The rows by name; null for missing values."""
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


def weighted_mean(values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"] | None = None) -> float:
    """Mean over clips that have a value; NaN if none has."""
    known = np.isfinite(values)
    if not known.any():
        return NAN
    chosen = None if weights is None else weights[known]
    return float(np.average(values[known], weights=chosen if chosen is not None and chosen.sum() > 0 else None))


def rounded(value: float) -> float | None:
    """The value to four places, for JSON; null for none."""
    return round(value, 4) if math.isfinite(value) else None


def _plain(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _number(value: float, *, sign: bool = False) -> str:
    if not math.isfinite(value):
        return "-"
    digits = 1 if abs(value) >= 100 else 3 if abs(value) >= 0.01 or abs(value) < 5e-6 else 5
    return f"{value:{'+' if sign else ''}.{digits}f}"


def _span(ends: Interval) -> str:
    return f"{_number(ends.low)} to {_number(ends.high)}" if math.isfinite(ends.low) else "-"


def draw(rows: Sequence[Row], path: Path, *, title: str) -> None:
    """Write a picture (.png, .pdf or .svg). Raises EchoAvatarError if the picture cannot be written."""
    from matplotlib.figure import Figure  # slow to import

    from echoavatar_lab.training.curves import save_figure

    figure = Figure(figsize=(8.0, 0.9 + 0.42 * len(rows)), layout="constrained")
    figure.suptitle(title, fontsize=11, x=0.02, ha="left", parse_math=False)
    axes = figure.subplots(len(rows), 1, squeeze=False)[:, 0]
    for axis, row in zip(axes, rows, strict=True):
        _line(axis, row)
    handles = [
        axes[0].plot([], [], "o", color=_MADE, label="made, 95 %")[0],
        axes[0].plot([], [], "|", color=_CHANCE, ms=11, mew=2, label="its chance")[0],
        axes[0].plot([], [], "D", color=_TRUTH, mfc="none", label="truth")[0],
        axes[0].plot([], [], "|", color=_TRUTH, ms=11, mew=1, label="its chance")[0],
    ]
    figure.legend(handles=handles, loc="upper right", ncols=4, fontsize=8, frameon=False)
    save_figure(figure, path, dpi=130)


def _line(axis: Any, row: Row) -> None:
    unit = f" ({row.unit})" if row.unit else ""
    axis.set_ylabel(row.name + unit, rotation=0, ha="right", va="center", fontsize=8)
    axis.set_yticks([])
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.tick_params(labelsize=7, length=2)
    shown = [x for x in (row.value, *row.interval, row.truth, row.chance, row.truth_chance) if math.isfinite(x)]
    if not shown:
        axis.set_xticks([])
        return
    low, high = min(shown), max(shown)
    room = max(0.08 * (high - low), 1e-3 * abs(high), 1e-3)
    axis.set_xlim(low - room, high + room)
    axis.set_ylim(-1, 1)
    if math.isfinite(row.interval.low):
        axis.hlines(0, *row.interval, color=_MADE, lw=3, alpha=0.35)
    axis.plot([row.value], [0], "o", color=_MADE, ms=6)
    axis.plot([row.truth], [0], "D", color=_TRUTH, mfc="none", ms=6)
    axis.plot([row.chance], [0], "|", color=_CHANCE, ms=13, mew=2)
    axis.plot([row.truth_chance], [0], "|", color=_TRUTH, ms=13, mew=1)
