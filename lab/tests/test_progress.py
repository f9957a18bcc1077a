import sys

import pytest

from echoavatar_lab.commands.progress import progress_bar


def test_work_is_told_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for is_terminal in (True, False):
        monkeypatch.setattr(sys.stderr, "isatty", lambda is_terminal=is_terminal: is_terminal, raising=False)
        with progress_bar() as say:
            say("reading", 1, 4)
            say("scoring", 2, 3)
        told = capsys.readouterr().err
        assert ("reading" in told, "2/3" in told) == (is_terminal, is_terminal)
