import json
from pathlib import Path

import pytest

from echoavatar.cli import main


def test_a_cpu_is_told_from_a_captured_graph(tiny_bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "graphs", "--model", str(tiny_bundle), "--device", "cpu", "--chunks", "2"]) == 0
    *_, where, last = capsys.readouterr().out.splitlines()
    assert "not captured" in where
    assert json.loads(last)["total"] > 0
