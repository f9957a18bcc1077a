import sys

import pytest

from echoavatar_lab.progress import progress_bar, watched


def test_work_is_told_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for is_terminal in (True, False):
        monkeypatch.setattr(sys.stderr, "isatty", lambda is_terminal=is_terminal: is_terminal, raising=False)
        with progress_bar() as say:
            say("reading", 1, 4)
            say("scoring", 2, 3)
        told = capsys.readouterr().err
        assert ("reading" in told, "2/3" in told) == (is_terminal, is_terminal)


def test_progress_is_told_after_each_item() -> None:
    told: list[tuple[int, int]] = []
    seen = []
    for item in watched("ab", lambda done, total: told.append((done, total))):
        seen.append((item, len(told)))
    assert seen == [("a", 0), ("b", 1)]
    assert told == [(1, 2), (2, 2)]
    assert list(watched("ab", None)) == ["a", "b"]
