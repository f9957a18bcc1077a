"""Results as pictures (SVG): means with intervals, and the ranking."""

import io
from collections.abc import Sequence

from matplotlib.figure import Figure

from .latex import TITLES
from .wire import Question
from .wire_owner import ResultRow, Strength

_COLOURS = {"dance": "#b4472e", "gesture": "#2e6db4"}


def draw_means(rows: Sequence[ResultRow], questions: Sequence[Question]) -> bytes:
    """A panel per question: each system's mean rating with its 95 % interval, by category."""
    systems = list(dict.fromkeys(row.system for row in rows))
    figure = Figure(figsize=(3.4 * len(questions), 1.2 + 0.55 * len(systems)), layout="constrained")
    for number, question in enumerate(questions):
        axes = figure.add_subplot(1, len(questions), number + 1)
        for row in rows:
            score = row.scores.get(question)
            if score is None:
                continue
            at = systems.index(row.system) + (-0.13 if row.category == "dance" else 0.13)
            axes.errorbar(
                score.mean, at, xerr=score.half or 0, fmt="o", color=_COLOURS[row.category], capsize=3, markersize=5
            )
        axes.axvline(0, color="#888", linewidth=0.8)
        axes.set(title=TITLES[question], xlim=(-2.1, 2.1), ylim=(max(len(systems), 1) - 0.5, -0.5), xlabel="rating")
        axes.set_yticks(range(len(systems)), systems if number == 0 else [""] * len(systems), parse_math=False)
        axes.spines[["top", "right"]].set_visible(False)
    shown = [category for category in _COLOURS if any(row.category == category for row in rows)]
    for category in shown:
        figure.axes[-1].plot([], [], "o", color=_COLOURS[category], label=category)
    if shown:
        figure.axes[-1].legend(loc="lower right", fontsize=8, frameon=False)
    return _svg(figure)


def draw_ranking(rows: Sequence[Strength]) -> bytes:
    """Bradley-Terry strengths over all categories: a panel per question, the strongest system on top."""
    rows = [row for row in rows if row.category == "all"]
    questions = list(dict.fromkeys(row.question for row in rows)) or ["overall_preference"]
    most = max((sum(row.question == question for row in rows) for question in questions), default=1)
    figure = Figure(figsize=(3.4 * len(questions), 1.2 + 0.45 * max(most, 1)), layout="constrained")
    for number, question in enumerate(questions):
        own = [row for row in rows if row.question == question]
        own.sort(key=lambda row: (row.group, row.rank))
        axes = figure.add_subplot(1, len(questions), number + 1)
        for at, row in enumerate(own):
            axes.plot([row.low, row.high], [at, at], color="#2e6db4", linewidth=2)
            axes.plot(row.strength, at, "o", color="#2e6db4", markersize=6)
        axes.axvline(0, color="#888", linewidth=0.8)
        axes.set(title=TITLES[question], xlabel="log strength", ylim=(max(len(own), 1) - 0.5, -0.5))
        axes.set_yticks(range(len(own)), [row.system for row in own], parse_math=False)
        axes.spines[["top", "right"]].set_visible(False)
    return _svg(figure)


def _svg(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
