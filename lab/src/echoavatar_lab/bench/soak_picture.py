"""A picture of soaks: resident memory over time, and the line through its last two thirds."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from echoavatar.errors import DependencyError, EchoAvatarError


def read_report(path: Path) -> dict[str, Any]:
    """The report on the last line of what `bench soak` printed.

    Raises:
        EchoAvatarError: there is none.
    """
    try:
        report = json.loads(path.read_text("utf-8").strip().rpartition("\n")[2])
        return {name: report[name] for name in ("memory_mb", "slope_mb_an_hour", "turns")}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise EchoAvatarError(f"{path} does not end with a report of `bench soak` ({error!r})") from error


def draw(reports: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Write the curves, by name.

    Raises:
        DependencyError: matplotlib is missing.
        EchoAvatarError: the picture cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise DependencyError("pictures need matplotlib; run: pip install 'echoavatar-lab'") from error
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for name, report in reports.items():
        seconds, memory = np.array(report["memory_mb"], np.float64).T
        (curve,) = axis.plot(seconds / 60, memory, lw=1.2)
        late = seconds >= seconds[-1] / 3
        slope = float(report["slope_mb_an_hour"])
        level = memory[late].mean() + slope * (seconds[late] - seconds[late].mean()) / 3600
        told = f"{name}: {slope:+.1f} MB an hour, {report['turns']} visits"
        axis.plot(seconds[late] / 60, level, "--", lw=1, color=curve.get_color(), label=told)
    axis.set(xlabel="minutes", ylabel="resident memory (MB)", ylim=(0, 1.1 * axis.get_ylim()[1]))
    axis.grid(alpha=0.3)
    axis.legend(loc="lower right", fontsize=8)
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise EchoAvatarError(f"cannot write {path} ({error}); name a .png in a folder that exists") from error
