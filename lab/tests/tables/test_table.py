import math
from pathlib import Path

import pytest

from echoavatar_lab.evaluation.table import Interval, Row
from echoavatar_lab.tables.table import (
    Cell,
    Column,
    Line,
    Table,
    Wanted,
    as_csv,
    cells,
    draw,
    latex,
    markdown,
    orderings,
    over_seeds,
    write,
)


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
        found = Cell(ours, ours - 1, 9.0)
        lines = [Line("truth", ours={"fid": Cell(0.0, 0.0, 0.1)}), Line("ours", ours={"fid": found})]
        return Table("t", "T", [Column("fid", "FID")], lines)

    truth, ours = over_seeds([table(1.0), table(2.0), table(3.0)]).lines
    assert truth.ours["fid"] == Cell(0.0, 0.0, 0.1)
    assert ours.ours["fid"] == Cell(2.0, 1.0, 9.0, spread=1.0)


TABLE = Table(
    "t",
    "A title",
    [Column("fid", "FID"), Column("ms", "Time", "ms", better="")],
    [Line("a_b", {"fid": 9.208}, {"fid": Cell(1.5, 1.0, 2.25), "ms": Cell(3.0)}), Line("none")],
    ["a note"],
)


def test_markdown_has_paper_and_ours_side_by_side() -> None:
    lines = markdown(TABLE).splitlines()
    assert lines[2] == "|  | FID ↓, paper | FID ↓, ours | Time (ms), ours |"
    assert lines[4] == "| a_b | 9.208 | 1.5 [1, 2.25] | 3 |"
    assert lines[5] == "| none | - | - | - |"
    assert lines[-1] == "- a note"


def test_csv_keeps_intervals_apart() -> None:
    assert as_csv(TABLE).splitlines() == [
        "row,fid_paper,fid,fid_low,fid_high,ms,ms_low,ms_high",
        "a_b,9.208,1.5,1,2.25,3,,",
        "none,,,,,,,",
    ]


def test_latex_escapes_what_it_must() -> None:
    text = latex(TABLE)
    assert r"a\_b & 9.208 & 1.5 [1, 2.25] & 3 \\" in text
    assert r"FID $\downarrow$, paper" in text
    assert text.startswith("% A title\n% a note\n\\begin{tabular}{lccc}")


def test_a_table_is_written_four_ways_and_the_picture_has_a_panel_for_each_column_of_ours(tmp_path: Path) -> None:
    paths = write(TABLE, tmp_path / "new")
    assert [path.suffix for path in paths] == [".md", ".csv", ".tex", ".png"]
    assert all(path.stat().st_size > 50 for path in paths)
    draw(TABLE, tmp_path / "t.svg")
    text = (tmp_path / "t.svg").read_text()
    assert all(said in text for said in ("FID", "Time (ms)", "paper", "a_b"))


def test_a_deviation_over_seeds_stands_beside_its_mean() -> None:
    table = Table("t", "T", [Column("fid", "FID")], [Line("a", {}, {"fid": Cell(2.0, 1.0, 4.0, 0.25)})])
    assert "| a | 2 ± 0.25 [1, 4] |" in markdown(table)
    assert as_csv(table).splitlines() == ["row,fid,fid_low,fid_high,fid_spread", "a,2,1,4,0.25"]
    assert r"2 $\pm$ 0.25 [1, 4]" in latex(table)
