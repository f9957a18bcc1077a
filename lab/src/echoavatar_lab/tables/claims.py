"""Which of the paper's claims a table shows: one line above or below another, with the interval of their difference.

A claim is shown if the interval is wholly on the paper's side of zero and every seed agrees, reversed if it is wholly
on the other side and every seed agrees, and not shown otherwise. The interval of a difference comes from those of both
lines (MOVER; Zou and Donner, Statistics in Medicine 2008) as if they were of different clips. They are of the same
clips, so it is rather too wide than too narrow.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

from .table import Cell, Claim, Column, Table

Verdict = Literal["shown", "not shown", "reversed"]


class Difference(NamedTuple):
    """How far one line is on the better side of another, with a 95 % interval (NaN: one of the lines has none)."""

    value: float
    low: float
    high: float


def difference(winner: Cell, loser: Cell, column: Column) -> Difference:
    """The lead of `winner` over `loser`: positive if it is better, in the unit of the column."""
    a, b = (loser, winner) if column.better == "lower" else (winner, loser)
    value = a.value - b.value
    return Difference(
        value,
        value - math.hypot(a.value - a.low, b.high - b.value),
        value + math.hypot(a.high - a.value, b.value - b.low),
    )


def verdict(lead: Difference, leads_by_seed: Sequence[float]) -> Verdict:
    """What the lead says of the claim, given the lead in each seed."""
    if lead.low > 0 and all(one > 0 for one in leads_by_seed):
        return "shown"
    if lead.high < 0 and all(one < 0 for one in leads_by_seed):
        return "reversed"
    return "not shown"


def judged(table: Table, seeds: Sequence[Table]) -> list[str]:
    """A note for each claim and column that was measured. `seeds`: the tables of the single seeds."""
    return [_told(table, seeds, claim, column) for claim, column in _measured(table)]


def _measured(table: Table) -> Iterator[tuple[Claim, Column]]:
    lines = {line.name: line.ours for line in table.lines}
    for claim in table.claims:
        for column in table.columns:
            if column.key in claim.columns and all(column.key in lines[n] for n in (claim.winner, claim.loser)):
                yield claim, column


def _told(table: Table, seeds: Sequence[Table], claim: Claim, column: Column) -> str:
    leads = [_lead(one, claim, column) for one in (table, *seeds)]
    found = verdict(leads[0], [lead.value for lead in leads[1:]])
    span = f" [{leads[0].low:.3g}, {leads[0].high:.3g}]" if math.isfinite(leads[0].low) else ", no interval"
    agree = sum(lead.value > 0 for lead in leads[1:])
    count = f"; {agree} of {len(seeds)} seeds agree" if len(seeds) > 1 else ""
    side = "below" if column.better == "lower" else "above"
    return (
        f"**{found.capitalize()}**: {column.title}, {claim.winner} {side} {claim.loser}"
        f" (by {leads[0].value:.3g}{span}{count})."
    )


def _lead(table: Table, claim: Claim, column: Column) -> Difference:
    cells = {line.name: line.ours[column.key] for line in table.lines if column.key in line.ours}
    return difference(cells[claim.winner], cells[claim.loser], column)
