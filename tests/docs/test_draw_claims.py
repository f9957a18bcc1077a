"""The claims that are drawn to be measured again: found with sentence, line and command, drawn by the date alone."""

from datetime import date
from pathlib import Path

import pytest
from scripts import draw_claims

PAGE = """# Page

It takes 5 ms a chunk,
and 3.5 % of a core (`--seconds 30 s`).

## One

    echoavatar bench stream --seconds 60

| part | ms |
|---|---:|
| codec | 12.5 |

- A list has 7 sessions.
- Another has none.

```sh
echoavatar bench post                # 4.0 ms
```

With [2.0](x) it is 0.5 m.
"""


def test_numbers_are_found_with_line_sentence_and_the_command_of_their_section(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draw_claims, "ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    found = [(one.number, one.line, one.command.split()[2]) for one in draw_claims.claims(page)]
    assert found == [
        ("5", 3, "stream"),
        ("3.5", 4, "stream"),
        ("12.5", 12, "stream"),
        ("7", 14, "stream"),
        ("2.0", 21, "post"),
        ("0.5", 21, "post"),
    ]
    assert draw_claims.claims(page)[0].sentence.startswith("It takes 5 ms a chunk, and 3.5 %")
    page.write_text("It takes 5 ms.\n")
    assert draw_claims.claims(page) == []


NOTHING_TO_MEASURE = """    echoavatar bench stream

It needs Python 3.11 and thing 2.78.0. It is 0.5 (before 0.4), where 0.7 is wanted 0.6.

| part | ours, ms | paper, ms | wanted |
|---|---:|---:|---|
| codec | 12.5 | 4.5 | at most 13 ms (missed: 12 %) |
"""


def test_what_measures_nothing_that_is_here_is_left_out_after_the_draw(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draw_claims, "ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text(NOTHING_TO_MEASURE)
    found = draw_claims.claims(page)
    why = [(one.number, one.left_out) for one in found]
    assert why[:2] == [("3.11", "version"), ("2.78", "version")]
    assert why[2:6] == [("0.5", ""), ("0.4", "before"), ("0.7", ""), ("0.6", "wanted")]
    assert why[6:] == [("12.5", ""), ("4.5", "paper"), ("13", "wanted"), ("12", "")]
    everything = draw_claims.draw([one._replace(left_out="") for one in found], date(2026, 11, 30), 9)
    assert {one.line for one in everything} == {3, 7}
    assert all(not one.left_out for one in draw_claims.draw(found, date(2026, 11, 30), 9))


def test_the_date_alone_decides() -> None:
    claims = [draw_claims.Claim("1", "a.md", line, "s", "c") for line in range(100)]
    first = draw_claims.draw(claims, date(2026, 11, 29), 10)
    assert first == draw_claims.draw(claims, date(2026, 11, 29), 10)
    assert first != draw_claims.draw(claims, date(2026, 11, 30), 10)
    assert len({one.line for one in first}) == 10
    assert draw_claims.draw(claims, date(2026, 11, 29), 20)[:10] == first  # more draws replace none
    assert draw_claims.table(first).count("| | |\n") == 9  # the last row ends the text
