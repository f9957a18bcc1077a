"""Draws the table of scores: one axis for each metric, with value, interval, truth and chance levels."""

import math
from collections.abc import Sequence
from pathlib import Path

from echoavatar.errors import DependencyError, EchoAvatarError

from .score_row import Row

_MADE, _TRUTH, _CHANCE = "#1f5fa8", "#2e2e2e", "#b5432a"


def want_matplotlib() -> None:
    """Raise DependencyError where matplotlib is missing; called before work whose end is a picture."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise DependencyError("pictures need matplotlib; run: pip install 'echoavatar-lab'") from error


def draw(rows: Sequence[Row], path: Path, *, title: str) -> None:
    """Write a picture (.png, .pdf or .svg).

    Raises:
        DependencyError: matplotlib is missing.
        EchoAvatarError: the picture cannot be written.
    """
    want_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 0.9 + 0.42 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11, x=0.02, ha="left")
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
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise EchoAvatarError(f"cannot write {path} ({error}); name a .png in a folder that exists") from error


def _line(axis, row: Row) -> None:  # type: ignore[no-untyped-def]
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
