"""The content of a table, the paper's numbers beside ours, and its formats: Markdown, CSV, LaTeX, a picture."""

import csv
import io
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from matplotlib.figure import Figure

from echoavatar.whole_file import make_output_folder, write_whole
from echoavatar_lab.evaluation.table import UNKNOWN, Row
from echoavatar_lab.training.curves import save_figure

NAN = float("nan")


class Cell(NamedTuple):
    """A number we measured, with its 95 % interval over clips and its deviation over seeds, if there is one."""

    value: float
    low: float = NAN
    high: float = NAN
    spread: float = NAN


@dataclass(frozen=True)
class Column:
    """A quantity."""

    key: str  # the name by which lines refer to it
    title: str  # its title in the paper
    unit: str = ""  # the unit of the printed number; empty for a pure number
    better: Literal["lower", "higher", ""] = "lower"  # the better direction; "" if there is none

    @property
    def heading(self) -> str:
        """Title, unit and an arrow to the better side."""
        arrow = {"lower": " ↓", "higher": " ↑", "": ""}[self.better]
        return f"{self.title}{f' ({self.unit})' if self.unit else ''}{arrow}"


@dataclass(frozen=True)
class Line:
    """A row: the paper's numbers and ours, by column. A missing number was not published or not measured."""

    name: str
    paper: Mapping[str, float] = field(default_factory=dict)
    ours: Mapping[str, Cell] = field(default_factory=dict)


class Claim(NamedTuple):
    """What the paper says: the line `winner` is on the better side of the line `loser` in these columns."""

    winner: str
    loser: str
    columns: Sequence[str]


@dataclass(frozen=True)
class Table:
    """All lines, with notes, and what the paper claims of them."""

    name: str
    title: str
    columns: Sequence[Column]
    lines: Sequence[Line]
    notes: Sequence[str] = ()
    claims: Sequence[Claim] = ()

    def has_paper(self, column: Column) -> bool:
        """Whether the paper gives this quantity for at least one line."""
        return any(column.key in line.paper for line in self.lines)

    def has_ours(self, column: Column) -> bool:
        """Whether we measured this quantity for at least one line."""
        return any(column.key in line.ours for line in self.lines)


def over_seeds(tables: Sequence[Table]) -> Table:
    """One table of several that differ in the seed: means with standard deviations, and intervals with mean ends.

    The seeds share the clips, so a mean's interval over clips is about as wide as that of one seed.
    """
    lines = [_over_seeds(versions) for versions in zip(*(table.lines for table in tables), strict=True)]
    return replace(tables[0], lines=lines)


def _over_seeds(versions: Sequence[Line]) -> Line:
    first = versions[0]
    found = {}
    for key, cell in first.ours.items():
        seeds = [line.ours[key] for line in versions if key in line.ours]
        spread = statistics.stdev(one.value for one in seeds) if len(seeds) > 1 else NAN
        value, low, high = (statistics.fmean(ends) for ends in zip(*(one[:3] for one in seeds), strict=True))
        found[key] = Cell(value, low, high, spread) if spread > 0 else cell
    return replace(first, ours=found)


class Wanted(NamedTuple):
    """The score that a column shows, the factor it is multiplied by, and which of its numbers is taken."""

    score: str
    factor: float = 1.0
    part: Literal["value", "excess", "truth"] = "value"


def cells(rows: Sequence[Row], wanted: Mapping[str, Wanted]) -> dict[str, Cell]:
    """Cells from scores, by column key. Scores that are missing or not finite are left out."""
    found = {row.name: row for row in rows}
    made = {}
    for key, (name, factor, part) in wanted.items():
        if name not in found:
            continue
        row = found[name]
        ends = {"value": row.interval, "excess": row.excess_interval, "truth": UNKNOWN}[part]
        value = {"value": row.value, "excess": row.excess, "truth": row.truth}[part]
        if math.isfinite(value):
            made[key] = Cell(value * factor, ends.low * factor, ends.high * factor)
    return made


def orderings(table: Table) -> list[str]:
    """For each column: how many pairs of lines have the same order in our numbers as in the paper's.

    Lines where the paper's number is 0 (the true motion against itself) do not count.
    """
    told = []
    for column in table.columns:
        both = [line for line in table.lines if column.key in line.paper and column.key in line.ours]
        both = [line for line in both if line.paper[column.key] != 0]
        pairs = [(a, b) for n, a in enumerate(both) for b in both[n + 1 :]]
        if not pairs:
            continue

        def rises(a: Line, b: Line, key: str = column.key) -> tuple[bool, bool]:
            return a.paper[key] < b.paper[key], a.ours[key].value < b.ours[key].value

        same = sum(paper == ours for paper, ours in (rises(a, b) for a, b in pairs))
        told.append(f"{column.title}: {same} of {len(pairs)} pairs of lines are in the paper's order.")
    return told


_OURS, _PAPER, _INK = "#1f5fa8", "#b5432a", "#2e2e2e"


class _Field(NamedTuple):
    heading: str
    values: list[str]


def write(table: Table, folder: Path) -> list[Path]:
    """Write `NAME.md`, `.csv`, `.tex` and `.png`; return their paths."""
    make_output_folder(folder)
    paths = [folder / f"{table.name}{suffix}" for suffix in (".md", ".csv", ".tex", ".png")]
    for path, text in zip(paths, (markdown(table), as_csv(table), latex(table)), strict=False):
        write_whole(path, text)
    draw(table, paths[-1])
    return paths


def markdown(table: Table) -> str:
    """The title, the table and the notes."""
    fields = _fields(table)
    lines = [f"# {table.title}", ""]
    lines.append("| " + " | ".join(["", *(each.heading for each in fields)]) + " |")
    lines.append("|---" + "|---:" * len(fields) + "|")
    for number, line in enumerate(table.lines):
        lines.append("| " + " | ".join([line.name, *(each.values[number] for each in fields)]) + " |")
    return "\n".join([*lines, "", *(f"- {note}" for note in table.notes)]) + "\n"


def as_csv(table: Table) -> str:
    """One line per row; value, lower and upper end have columns of their own, empty if there is none.

    A table over several seeds has the standard deviation in a further column.
    """
    is_over_seeds = any(math.isfinite(cell.spread) for line in table.lines for cell in line.ours.values())
    kinds = ("", "_low", "_high", "_spread")[: 4 if is_over_seeds else 3]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["row"]
    for column in table.columns:
        head += [f"{column.key}_paper"] if table.has_paper(column) else []
        head += [f"{column.key}{kind}" for kind in kinds] if table.has_ours(column) else []
    writer.writerow(head)
    for line in table.lines:
        cells = [line.name]
        for column in table.columns:
            if table.has_paper(column):
                cells.append(_plain(line.paper.get(column.key, math.nan)))
            if table.has_ours(column):
                cells += [_plain(value) for value in line.ours.get(column.key, Cell(math.nan))[: len(kinds)]]
        writer.writerow(cells)
    return out.getvalue()


def latex(table: Table) -> str:
    """A `tabular` for the booktabs package; the notes are comments."""
    fields = _fields(table)
    lines = [f"% {note}" for note in (table.title, *table.notes)]
    lines += [rf"\begin{{tabular}}{{l{'c' * len(fields)}}}", r"\toprule"]
    lines.append(" & ".join(["", *(_escaped(each.heading) for each in fields)]) + r" \\")
    lines.append(r"\midrule")
    for number, line in enumerate(table.lines):
        values = [_escaped(each.values[number]) for each in fields]
        lines.append(" & ".join([_escaped(line.name), *values]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def draw(table: Table, path: Path) -> None:
    """Write a PNG, or by the suffix of the path a PDF or SVG.

    Each column has a panel with bars for our numbers and diamonds for the paper's. The paper's numbers have an axis of
    their own at the top: data and extractors differ, so only the order is comparable.
    """
    columns = [column for column in table.columns if table.has_ours(column)]
    figure = Figure(figsize=(2.0 + 2.8 * len(columns), 1.6 + 0.36 * len(table.lines)), layout="constrained")
    figure.suptitle(table.title, fontsize=11)
    axes = figure.subplots(1, len(columns), squeeze=False, sharey=True)[0]
    for axis, column in zip(axes, columns, strict=True):
        _panel(axis, table, column)
    axes[0].set_yticks(range(len(table.lines)), [line.name for line in table.lines], fontsize=9)
    axes[0].invert_yaxis()
    save_figure(figure, path, dpi=130)


def _fields(table: Table) -> list[_Field]:
    found = []
    for column in table.columns:
        if table.has_paper(column):
            values = [_number(line.paper.get(column.key, math.nan)) for line in table.lines]
            found.append(_Field(f"{column.heading}, paper", values))
        if table.has_ours(column):
            found.append(_Field(f"{column.heading}, ours", [_ours(line, column.key) for line in table.lines]))
    return found


def _ours(line: Line, key: str) -> str:
    if key not in line.ours:
        return "-"
    value, low, high, spread = line.ours[key]
    span = f" ± {spread:.2g}" if math.isfinite(spread) else ""
    span += f" [{_number(low)}, {_number(high)}]" if math.isfinite(low) else ""
    return _number(value) + span


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "-"


def _plain(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else ""


def _escaped(text: str) -> str:
    for plain, mark in (
        ("&", r"\&"),
        ("%", r"\%"),
        ("_", r"\_"),
        ("↓", r"$\downarrow$"),
        ("↑", r"$\uparrow$"),
        ("±", r"$\pm$"),
    ):
        text = text.replace(plain, mark)
    return text


def _panel(axis: Any, table: Table, column: Column) -> None:
    for place, line in enumerate(table.lines):
        if column.key not in line.ours:
            continue
        value, low, high, spread = line.ours[column.key]
        axis.barh(place, value, color=_OURS, alpha=0.75, height=0.6)
        if math.isfinite(low):
            axis.hlines(place, low, high, color=_INK, lw=1.5)
        if math.isfinite(spread):
            axis.errorbar(value, place, xerr=spread, color=_INK, lw=0, elinewidth=4, alpha=0.45)
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
