from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.corpora.rehearsal.corpus import Plan, rehearse


@pytest.mark.slow
def test_from_nothing_to_a_bundle(tmp_path: Path) -> None:
    """The whole way that `echoavatar train --help` describes, at sizes that mean nothing but pass every door."""
    rehearse(Plan(hours=16 * 16 / 3600, seed=1, folder=tmp_path / "corpus", clip_seconds=16.0))
    corpus, runs = str(tmp_path / "corpus"), tmp_path / "runs"
    parts = ["--codec", str(runs / "codec"), "--tokenizer", str(runs / "tokenizer")]
    assert main(["train", "codec", corpus, "-o", str(runs / "codec"), "--minutes", "0.2"]) == 0
    assert main(["train", "tokenizer", corpus, "-o", str(runs / "tokenizer"), "--steps", "30"]) == 0
    assert main(["train", "tokens", corpus, "-o", str(runs / "tokens"), *parts]) == 0
    small = ["--steps", "3", "--batch", "1", "--width", "32", "--layers", "1"]
    assert main(["train", "generator", str(runs / "tokens"), "-o", str(runs / "generator"), *parts, *small]) == 0
    assert main(["bundle", str(runs), "-o", str(tmp_path / "bundle"), "--no-graphs"]) == 0
    assert load_bundle(tmp_path / "bundle").tokenizer.config.layers == load_bundle("default").tokenizer.config.layers


def test_a_missing_corpus_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "tokenizer", str(tmp_path / "none"), "-o", str(tmp_path)]) == 1
    assert "is not a folder" in capsys.readouterr().err
