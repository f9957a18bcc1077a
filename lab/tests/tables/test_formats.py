import sys
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.errors import DependencyError
from echoavatar_lab.tables.formats import as_csv, draw, latex, markdown, want_pictures, write
from echoavatar_lab.tables.table import Cell, Column, Line, Table

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
    table = Table("t", "T", [Column("fid", "FID")], [Line("a", {}, {"fid": Cell(2.0, spread=0.25)})])
    assert "| a | 2 ± 0.25 |" in markdown(table)
    assert as_csv(table).splitlines() == ["row,fid,fid_low,fid_high,fid_spread", "a,2,,,0.25"]
    assert r"2 $\pm$ 0.25" in latex(table)


def test_missing_matplotlib_is_told_before_any_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(DependencyError, match="pip install"):
        want_pictures()
    assert main(["reproduce", "main", "-o", str(tmp_path)]) == 1
    assert not any(tmp_path.iterdir())
