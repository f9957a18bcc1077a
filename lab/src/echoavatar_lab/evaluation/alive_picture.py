"""Pictures of a run of `echoavatar evaluate --alive`: a contact sheet of its takes, and a plot beside people."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar_lab.evaluation.sheet import contact_sheet

from .alive import AliveReport, Measured, Take, captured_kind
from .captured_people import KINDS, PEOPLE
from .metrics.liveliness import STATISTICS

_MADE, _CAPTURED = "#1f5fa8", "#8a8a8a"
_STILLS, _STILL_SIZE = 12, (90, 130)


def sheet(takes: Sequence[Take]) -> UInt8[np.ndarray, "h w 3"]:
    """A row of twelve stills for each take, in the order of the takes."""
    rows = [contact_sheet(take.motion, columns=_STILLS, rows=1, size=_STILL_SIZE) for take in takes]
    return np.concatenate(rows)


def draw(found: AliveReport, path: Path) -> None:
    """Write a panel for each statistic: a dot for each window, grey for captured ones, a bar for people's range.

    Raises:
        DependencyError: matplotlib is missing.
        EchoAvatarError: the picture cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise DependencyError("pictures need matplotlib; run: pip install 'echoavatar-lab'") from error
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    for axis, (name, unit) in zip(figure.subplots(3, 3).flat, STATISTICS.items(), strict=True):
        for place, kind in enumerate(KINDS):
            mean, low, high = PEOPLE[kind][name]
            axis.vlines(place, low, high, color="#d9d9d9", lw=16)
            axis.hlines(mean, place - 0.22, place + 0.22, color="#5c5c5c", lw=1.5)
            _dots(axis, place + 0.13, found.captured, captured_kind(kind), name, _CAPTURED)
            _dots(axis, place - 0.13, found.made, kind, name, _MADE)
        axis.set_xticks(range(len(KINDS)), KINDS, fontsize=8)
        axis.set_title(f"{name}{f' ({unit})' if unit else ''}", fontsize=9)
        axis.tick_params(axis="y", labelsize=8)
    figure.suptitle(
        "blue: windows of the bundle; grey dots: captured; bar and line: range and mean of people", fontsize=9
    )
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise EchoAvatarError(f"cannot write {path} ({error}); name a .png in a folder that exists") from error


def _dots(axis, place: float, measured: Sequence[Measured], kind: str, name: str, colour: str) -> None:  # type: ignore[no-untyped-def]
    values = [row[name] for one in measured if one.take.kind == kind for row in one.windows]
    axis.plot([place] * len(values), values, "o", color=colour, ms=3.5, alpha=0.6, mew=0)
