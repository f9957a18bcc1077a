import json
from pathlib import Path

import numpy as np
import pytest
from tests.evaluation.clips import clip, folder

from echoavatar.cli import main


@pytest.fixture
def folders(tmp_path: Path) -> list[str]:
    truth = folder(tmp_path / "true", [clip("a"), clip("b", every_s=0.7)])
    made = folder(tmp_path / "made", [clip("a", size=0.2), clip("b", size=0.25)])
    return [str(made), str(truth)]


def test_a_table_then_one_line_of_json(folders: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("librosa", reason="the evaluate extra is not installed")
    pytest.importorskip("matplotlib", reason="the evaluate extra is not installed")
    assert main(["score", *folders, "--picture", str(tmp_path / "a.png")]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    told = json.loads(said[-1])
    assert {line.split()[0] for line in said[2:-1]} == told.keys()
    assert told["fid"]["value"] > 0
    assert told["ba_g_emage"]["chance"] is not None
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_json_alone_without_sound_and_extractor(folders: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", *folders, "--no-audio", "--extractor", "none", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert "skate" in told
    assert not {"fid", "ba_g_sharp"} & told.keys()


def test_retrieval_of_embeddings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = np.random.default_rng(0).normal(size=(40, 8))
    np.savez(tmp_path / "pairs.npz", audio=values, motion=values)
    assert main(["score", "--embeddings", str(tmp_path / "pairs.npz"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["a2m_medr_all"]["value"] == 1


def test_errors_are_one_line(folders: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, complaint in (
        (["score"], "give two folders"),
        (["score", folders[0]], "give two folders"),
        (["score", str(tmp_path / "none"), folders[1]], "is not a folder"),
        (["score", *folders, "--extractor", str(tmp_path)], "is not a checkpoint"),
    ):
        assert main(words) == 1
        error = capsys.readouterr().err
        assert complaint in error
        assert error.count("\n") == 1


def test_a_bundle_makes_the_motion_and_the_runtime_heads_the_table(
    tmp_path: Path, tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = folder(tmp_path / "true", [clip("a", 60)], is_corpus=True)
    words = [str(tmp_path / "made"), str(truth), "--extractor", "none", "--no-audio"]
    made = ["--model", str(tiny_bundle), "--runtime", "paper", "--seed", "5"]
    assert main(["score", *words, "--runtime", "paper"]) == 1
    assert "--runtime needs --model" in capsys.readouterr().err
    sound = [word for word in words if word != "--no-audio"]
    assert main(["score", *sound, *made, "--kind", "speech"]) == 0
    assert capsys.readouterr().out.startswith("runtime: paper; model: ")
    assert main(["score", *words]) == 0  # the note stays with the motion
    assert capsys.readouterr().out.startswith("runtime: paper; model: ")
