import math

import pytest

from echoavatar_lab.evaluation.table import Interval, Row
from echoavatar_lab.tables.table import Cell, Column, Line, Table, Wanted, cells, orderings, over_seeds


def test_cells_are_scores_in_the_columns_unit() -> None:
    row = Row("ba", "", 0.5, Interval(0.4, 0.6), 0.4, 0.1, Interval(0.05, 0.15), truth=0.7)
    assert cells([row], {"x": Wanted("ba", 10.0), "y": Wanted("other")}) == {"x": Cell(5.0, 4.0, 6.0)}
    assert cells([row], {"x": Wanted("ba", 10.0, "truth")})["x"].value == pytest.approx(7.0)
    assert cells([row], {"x": Wanted("ba", 10.0, "excess")})["x"] == Cell(1.0, 0.5, 1.5)


def test_what_could_not_be_measured_is_left_out() -> None:
    assert cells([Row("ba", "", math.nan)], {"x": Wanted("ba")}) == {}


def test_orderings_count_pairs_the_right_way_round() -> None:
    """Paper a < b < c; ours a < c < b: two of three pairs agree; the truth is at 0 by definition."""
    lines = [Line(n, {"f": p}, {"f": Cell(o)}) for n, p, o in (("t", 0, 0), ("a", 1, 10), ("b", 2, 30), ("c", 3, 20))]
    table = Table("t", "T", [Column("f", "FID"), Column("g", "G")], lines)
    assert orderings(table) == ["FID: 2 of 3 pairs of lines are in the paper's order."]


def test_a_heading_says_unit_and_direction() -> None:
    assert Column("d", "Diversity", "m", better="higher").heading == "Diversity (m) ↑"


def test_several_seeds_become_means_with_deviations() -> None:
    def table(ours: float) -> Table:
        lines = [Line("truth", ours={"fid": Cell(0.0, 0.0, 0.1)}), Line("ours", ours={"fid": Cell(ours, 0.0, 9.0)})]
        return Table("t", "T", [Column("fid", "FID")], lines)

    truth, ours = over_seeds([table(1.0), table(2.0), table(3.0)]).lines
    assert truth.ours["fid"] == Cell(0.0, 0.0, 0.1)
    assert ours.ours["fid"][0] == 2.0
    assert ours.ours["fid"].spread == 1.0
    assert math.isnan(ours.ours["fid"].low)
