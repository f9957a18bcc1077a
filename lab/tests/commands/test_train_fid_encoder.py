import json
from pathlib import Path

import pytest
from lab.tests.evaluation.clips import clip, folder

from echoavatar.checkpoint import read_card
from echoavatar.cli import main

SMALL = ["--steps", "4", "--width", "8", "--latent", "4"]


def test_a_corpus_trains_an_extractor_that_score_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    corpus = folder(
        tmp_path / "corpus", [clip("a", 100, split="train"), clip("b", 100), clip("c", 120)], is_corpus=True
    )
    run = tmp_path / "run"
    assert main(["train", "fid-encoder", str(corpus), "-o", str(run), *SMALL]) == 0
    card = read_card(run)
    assert str(card["command"]).startswith("echoavatar train fid-encoder")
    assert card["step"] == 4
    assert {"explained_train", "explained_test"} == set(card["scores"])  # type: ignore[call-overload]
    assert main(["train", "fid-encoder", str(corpus), "-o", str(run), *SMALL]) == 0  # done already: nothing to do
    capsys.readouterr()
    words = ["score", str(corpus), str(corpus), "--no-audio", "--extractor", str(run), "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["fid"]["value"] == pytest.approx(0, abs=1e-6)


def test_a_corpus_without_training_clips_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    corpus = folder(tmp_path / "corpus", [clip("b", 100)], is_corpus=True)
    assert main(["train", "fid-encoder", str(corpus), "-o", str(tmp_path / "run"), *SMALL]) == 1
    assert "no training clips" in capsys.readouterr().err
