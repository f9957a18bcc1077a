import json

import pytest
import torch

from echoavatar.cli import main


def test_the_command_ends_with_the_totals(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(torch, "set_num_threads", lambda count: None)  # for the whole process
    assert main(["bench", "post", "--chunks", "20", "--sessions", "2"]) == 0
    *table, last = capsys.readouterr().out.splitlines()
    assert json.loads(last)["sessions"] == 2
    assert table[0].endswith("each of 2")
