import json
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.rehearsal.corpus import Plan, rehearse

pytest.importorskip("librosa", reason="the evaluate extra is not installed")


def test_the_last_line_is_json(tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rehearse(Plan(hours=16 * 8 / 3600, seed=2, folder=tmp_path, clip_seconds=8.0))
    assert main(["evaluate", str(tiny_bundle), "--corpus", str(tmp_path)]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    assert json.loads(said[-1])["mpjpe_body_mm"] > 0
    assert any(line.startswith("skate_cm_s") for line in said)


def test_a_corpus_without_test_clips_is_refused(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rehearse(Plan(hours=0.001, seed=2, folder=tmp_path, clip_seconds=8.0))
    assert main(["evaluate", str(tiny_bundle), "--corpus", str(tmp_path)]) == 1
    assert "no test clips" in capsys.readouterr().err
