"""A table as Markdown, CSV and LaTeX: the paper's numbers and ours side by side, ours with their intervals."""

import csv
import io
import math
from typing import NamedTuple

from .table import Cell, Line, Table


class _Field(NamedTuple):
    heading: str
    values: list[str]


def markdown(table: Table) -> str:
    """Title, table, notes."""
    fields = _fields(table)
    lines = [f"# {table.title}", ""]
    lines.append("| " + " | ".join(["", *(each.heading for each in fields)]) + " |")
    lines.append("|---" + "|---:" * len(fields) + "|")
    for number, line in enumerate(table.lines):
        lines.append("| " + " | ".join([line.name, *(each.values[number] for each in fields)]) + " |")
    return "\n".join([*lines, "", *(f"- {note}" for note in table.notes)]) + "\n"


def as_csv(table: Table) -> str:
    """One line a row; value, low and high end in columns of their own, empty where there is none."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["row"]
    for column in table.columns:
        head += [f"{column.key}_paper"] if table.has_paper(column) else []
        head += [f"{column.key}", f"{column.key}_low", f"{column.key}_high"] if table.has_ours(column) else []
    writer.writerow(head)
    for line in table.lines:
        cells = [line.name]
        for column in table.columns:
            if table.has_paper(column):
                cells.append(_plain(line.paper.get(column.key, math.nan)))
            if table.has_ours(column):
                cells += [_plain(value) for value in line.ours.get(column.key, Cell(math.nan))]
        writer.writerow(cells)
    return out.getvalue()


def latex(table: Table) -> str:
    """A `tabular` for booktabs; notes as comments."""
    fields = _fields(table)
    lines = [f"% {note}" for note in (table.title, *table.notes)]
    lines += [rf"\begin{{tabular}}{{l{'c' * len(fields)}}}", r"\toprule"]
    lines.append(" & ".join(["", *(_escaped(each.heading) for each in fields)]) + r" \\")
    lines.append(r"\midrule")
    for number, line in enumerate(table.lines):
        values = [_escaped(each.values[number]) for each in fields]
        lines.append(" & ".join([_escaped(line.name), *values]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


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
    value, low, high = line.ours[key]
    span = f" [{_number(low)}, {_number(high)}]" if math.isfinite(low) else ""
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
    ):
        text = text.replace(plain, mark)
    return text
