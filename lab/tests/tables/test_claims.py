import pytest

from echoavatar_lab.tables.claims import difference, judged, verdict
from echoavatar_lab.tables.table import Cell, Claim, Column, Line, Table, over_seeds

FID, BEATS = Column("fid", "FID"), Column("ba", "BA", better="higher")


def table(good: Cell, bad: Cell) -> Table:
    lines = [Line("with", {}, {"fid": good, "ba": Cell(1.0)}), Line("without", {}, {"fid": bad})]
    return Table("t", "T", (FID, BEATS), lines, claims=(Claim("with", "without", ("fid", "ba")),))


def test_the_better_side_is_the_columns() -> None:
    low, high = Cell(1.0, 0.0, 2.0), Cell(5.0, 4.0, 6.0)
    assert difference(low, high, FID).value == 4
    assert difference(high, low, BEATS).value == 4
    assert difference(low, high, BEATS).value == -4


def test_intervals_of_both_lines_add_as_those_of_independent_numbers() -> None:
    """Three below and four above on the sides that count: five, not seven."""
    lead = difference(Cell(10.0, 9.0, 13.0), Cell(20.0, 16.0, 90.0), FID)
    assert lead.low == pytest.approx(10 - 5)
    assert difference(Cell(20.0, 16.0, 90.0), Cell(10.0, 9.0, 13.0), BEATS).low == pytest.approx(10 - 5)


@pytest.mark.parametrize(
    ("good", "bad", "leads", "found"),
    [
        (Cell(1, 0, 2), Cell(5, 4, 6), (4, 4, 4), "shown"),
        (Cell(5, 4, 6), Cell(1, 0, 2), (-4, -4, -4), "reversed"),
        (Cell(1, 0, 5), Cell(5, 1, 6), (4, 4, 4), "not shown"),  # the interval reaches over zero
        (Cell(1, 0, 2), Cell(5, 4, 6), (14, -1, -1), "not shown"),  # one seed makes the mean
        (Cell(5, 4, 6), Cell(1, 0, 2), (-14, 1, 1), "not shown"),
        (Cell(1), Cell(5), (4,), "not shown"),  # no interval
    ],
)
def test_a_claim_needs_an_interval_beside_zero_and_every_seed(good: Cell, bad: Cell, leads, found: str) -> None:
    assert verdict(difference(good, bad, FID), leads) == found


def test_notes_judge_what_was_measured_and_count_the_seeds() -> None:
    seeds = [table(Cell(1, 0, 2), Cell(5, 4, 6)), table(Cell(2, 1, 3), Cell(9, 8, 10))]
    assert judged(over_seeds(seeds), seeds) == [
        "**Shown**: FID, with below without (by 5.5 [4.09, 6.91]; 2 of 2 seeds agree)."
    ]
    alone = table(Cell(5), Cell(1))
    assert judged(alone, [alone]) == ["**Not shown**: FID, with below without (by -4, no interval)."]
