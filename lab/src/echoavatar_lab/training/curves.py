"""Plots the metrics of runs: one plot for each metric, runs side by side, smoothed curves over the raw values."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter1d

from echoavatar.errors import EchoAvatarError
from echoavatar.whole_file import whole_file

from .metrics_log import FILE, read_metrics

COLOURS = ("#1f5fa8", "#c8553d", "#3a8f5c", "#8d5fb0", "#b8860b", "#4d4d4d")
LEFT_OUT = ("seconds",)
FIRST = ("loss", "gradient", "rate")
_WIDE = 20.0  # draw a metric on a logarithmic scale if its largest value exceeds its smallest by this factor
_COLUMNS = 3
MOST_PLOTS = 200


class Curve(NamedTuple):
    """One metric of one run."""

    steps: Float[np.ndarray, " n"]
    values: Float[np.ndarray, " n"]


def read_curves(folder: Path) -> dict[str, Curve]:
    """All numbers in a run's `metrics.jsonl` by name; nested ones are called `outer.inner`.

    Raises EchoAvatarError if the file is missing or holds no metrics.
    """
    path = folder / FILE if folder.is_dir() else folder
    found: dict[str, list[tuple[float, float]]] = {}
    for told in read_metrics(path):
        step = float(told.pop("step"))
        for name, value in _flat(told):
            found.setdefault(name, []).append((step, value))
    curves = {name: Curve(*np.array(points, float).T) for name, points in found.items() if name not in LEFT_OUT}
    if not curves:
        raise EchoAvatarError(f"{path} holds no metrics yet; let the run take a few steps")
    return curves


def _flat(told: Mapping[str, Any], prefix: str = "") -> list[tuple[str, float]]:
    flat = []
    for name, value in told.items():
        if prefix.startswith("held_out.") and isinstance(value, list) and len(value) == 2:
            value = value[0]  # a mean and its standard error, from `align`
        if isinstance(value, dict):
            flat += _flat(value, f"{prefix}{name}.")
        elif isinstance(value, int | float) and math.isfinite(value):
            flat.append((prefix + name, float(value)))
    return flat


def smoothed(values: Float[np.ndarray, " n"], window: int) -> Float[np.ndarray, " n"]:
    """Moving average over `window` values, fewer at the ends."""
    size = 2 * min(window // 2, len(values) // 2) + 1
    counted = uniform_filter1d(np.ones(len(values)), size, mode="constant")
    return np.asarray(uniform_filter1d(values, size, mode="constant") / counted)


def is_wide(curves: Sequence[Curve]) -> bool:
    """Whether a logarithmic scale is better: all values are positive and span a large factor."""
    values = np.concatenate([curve.values for curve in curves])
    return bool(values.min() > 0 and values.max() / values.min() > _WIDE)


def draw(runs: Mapping[str, Mapping[str, Curve]], path: Path, *, metrics: Sequence[str] = ()) -> None:
    """Write a picture (.png, .pdf or .svg) of the metrics named, or of all.

    Raises EchoAvatarError if no run has a metric of that name, or the picture cannot be written.
    """
    known = _in_order({name for curves in runs.values() for name in curves})
    if unknown := [name for name in metrics if name not in known]:
        raise EchoAvatarError(f"no run has the metric {unknown[0]}; there are {', '.join(known)}")
    shown = list(metrics) or known
    if len(shown) > MOST_PLOTS:
        raise EchoAvatarError(f"{len(shown):,} metrics are more than {MOST_PLOTS} plots; choose with --metrics")
    columns = min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(4.2 * columns, 0.5 + 2.5 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat[len(shown) :]:
        axis.set_axis_off()
    for axis, name in zip(axes.flat, shown, strict=False):
        _plot(axis, name, {run: curves[name] for run, curves in runs.items() if name in curves}, list(runs))
    lines = [axes[0, 0].plot([], [], color=_colour(at), lw=2)[0] for at in range(len(runs))]
    ncols = min(len(runs), 4)
    legend = figure.legend(lines, list(runs), loc="outside upper left", ncols=ncols, fontsize=8, frameon=False)
    for text in legend.get_texts():
        text.set_parse_math(False)
    save_figure(figure, path, dpi=120)


def save_figure(figure: Figure, path: Path, *, dpi: int = 110) -> None:
    """Write a plot: .png, .pdf or .svg. Raises EchoAvatarError if it cannot be written."""
    with whole_file(path, failures=(ValueError,)) as partial:
        figure.savefig(partial, dpi=dpi, format=path.suffix[1:].lower() or "png")


def _plot(axis: Any, name: str, curves: Mapping[str, Curve], runs: Sequence[str]) -> None:
    for run, curve in curves.items():
        colour = _colour(runs.index(run))
        few = len(curve.steps) < 25
        axis.plot(
            curve.steps,
            curve.values,
            color=colour,
            alpha=1.0 if few else 0.22,
            lw=1.4 if few else 0.8,
            marker="o" if len(curve.steps) < 8 else None,
            ms=3,
        )
        if not few:
            axis.plot(curve.steps, smoothed(curve.values, max(5, len(curve.values) // 30)), color=colour, lw=1.6)
    if is_wide(list(curves.values())):
        axis.set_yscale("log")
    axis.set_title(name, fontsize=9, loc="left", parse_math=False)
    axis.tick_params(labelsize=7, length=2)
    axis.grid(alpha=0.25, lw=0.5)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    axis.set_xlabel("step", fontsize=7)


def _colour(index: int) -> str:
    return COLOURS[index % len(COLOURS)]


def _in_order(names: set[str]) -> list[str]:
    return [name for name in FIRST if name in names] + sorted(names - set(FIRST))
