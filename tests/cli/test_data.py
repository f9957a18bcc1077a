from pathlib import Path

import pytest

from echoavatar.cli import main
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


def test_nonsense_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "rehearse", "--hours", "-1", "-o", str(tmp_path)]) == 1
    assert "must be positive" in capsys.readouterr().err
