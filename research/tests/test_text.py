from echoavatar_research.table import Cell, Column, Line, Table
from echoavatar_research.text import as_csv, latex, markdown

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
