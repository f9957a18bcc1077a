from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.corpora.rehearsal.corpus import Plan, rehearse
from echoavatar.data import Corpus


def test_a_corpus_is_made_and_completed(tmp_path: Path) -> None:
    """0.02 hours are two clips, the fewest there are; a second run finds nothing to do."""
    words = ["data", "rehearse", "--hours", "0.02", "--seed", "3", "-o", str(tmp_path), "--workers", "1"]
    assert main(words) == 0
    corpus = Corpus(tmp_path)
    assert len(corpus.names()) == 2
    before = [corpus.path(name).stat().st_mtime_ns for name in corpus.names()]
    assert main(words) == 0
    assert [corpus.path(name).stat().st_mtime_ns for name in corpus.names()] == before


def test_a_corpus_can_be_measured_and_looked_at(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rehearse(Plan(hours=0.001, seed=4, folder=tmp_path, clip_seconds=20.0))
    assert main(["data", "describe", str(tmp_path)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0].split() == ["speech", "music", "silence"]
    assert any(line.startswith("wrist_speed_mean_m_s") for line in table)
    alive = next(line for line in table if line.startswith("hand_speed"))
    assert "0.94 (0.57 to 1.12)" in alive
    assert main(["data", "preview", str(tmp_path), "-o", str(tmp_path / "p"), "--clips", "1", "--seconds", "0.5"]) == 0
    assert sorted(path.suffix for path in (tmp_path / "p").iterdir()) == [".mp4", ".png"]
