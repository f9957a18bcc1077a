"""A table as a picture: one panel a column that we measured, a bar a line with its interval, the paper as diamonds.

The paper's numbers have an axis of their own (above), since data and extractors differ: only the order can be compared.
"""

import math
from pathlib import Path
from typing import Any

from echoavatar.errors import DependencyError

from .table import Column, Table

_OURS, _PAPER = "#1f5fa8", "#b5432a"


def draw(table: Table, path: Path) -> None:
    """Write a PNG (or PDF, SVG by the name).

    Raises:
        DependencyError: matplotlib is missing.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise DependencyError("pictures need matplotlib; run: pip install 'echoavatar[evaluate]'") from error
    columns = [column for column in table.columns if table.has_ours(column)]
    figure = Figure(figsize=(2.0 + 2.8 * len(columns), 1.6 + 0.36 * len(table.lines)), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(table.title, fontsize=11)
    axes = figure.subplots(1, len(columns), squeeze=False, sharey=True)[0]
    for axis, column in zip(axes, columns, strict=True):
        _panel(axis, table, column)
    axes[0].set_yticks(range(len(table.lines)), [line.name for line in table.lines], fontsize=9)
    axes[0].invert_yaxis()
    figure.savefig(path, dpi=130)


def _panel(axis: Any, table: Table, column: Column) -> None:
    for place, line in enumerate(table.lines):
        if column.key not in line.ours:
            continue
        value, low, high = line.ours[column.key]
        axis.barh(place, value, color=_OURS, alpha=0.75, height=0.6)
        if math.isfinite(low):
            axis.hlines(place, low, high, color="#2e2e2e", lw=1.5)
    axis.set_xlabel(f"{column.heading}, ours", fontsize=9, color=_OURS)
    axis.tick_params(axis="x", labelsize=8)
    axis.spines[["right"]].set_visible(False)
    if not table.has_paper(column):
        axis.spines[["top"]].set_visible(False)
        return
    above = axis.twiny()
    known = [(line.paper[column.key], n) for n, line in enumerate(table.lines) if column.key in line.paper]
    above.plot(*zip(*known, strict=True), "D", color=_PAPER, mfc="none", ms=6)
    above.set_xlim(left=min(0, *(value for value, _ in known)) if len(known) > 1 else None)
    above.set_xlabel("paper (not comparable)", fontsize=9, color=_PAPER)
    above.tick_params(axis="x", labelsize=8)
