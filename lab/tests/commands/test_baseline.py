from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.clips import MUSIC, clicks, clip, folder

from echoavatar.cli import main
from echoavatar.models.audio import write_wav
from echoavatar_lab.data import Clip


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    clips = [clip("a", 100, split="train"), clip("b", 100, split="train"), clip("c", 90, kind=MUSIC)]
    return folder(tmp_path / "corpus", clips, is_corpus=True)


@pytest.mark.parametrize("kind", ["mean", "random", "nearest"])
def test_clips_for_a_corpus_and_for_sound_files(kind: str, corpus: Path, tmp_path: Path) -> None:
    write_wav(tmp_path / "my_music.wav", clicks(70, 0.5))
    out = tmp_path / "made"
    words = ["baseline", kind, "--train", str(corpus), str(corpus), str(tmp_path / "my_music.wav"), "-o", str(out)]
    assert main(words) == 0
    assert sorted(path.name for path in out.iterdir()) == ["c.npz", "my_music.npz"]
    held_out, own = Clip.load(out / "c.npz"), Clip.load(out / "my_music.npz")
    assert (held_out.frames, own.frames) == (90, 70)
    assert held_out.domain[0] == own.domain[0] == MUSIC
    assert np.ptp(held_out.rotations, axis=0).max() == 0 if kind == "mean" else True


def test_baselines_can_be_scored(corpus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = str(tmp_path / "made")
    assert main(["baseline", "random", "--train", str(corpus), str(corpus), "-o", made]) == 0
    assert main(["score", made, str(corpus), "--common"]) == 0
    assert "ba_d_sharp" in capsys.readouterr().out


def test_bad_audio_files_are_refused(corpus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_wav(tmp_path / "c.wav", clicks(70, 0.5))
    for words, complaint in (
        ([str(corpus), str(tmp_path / "c.wav")], "two audio files are named c"),
        ([str(tmp_path / "none.wav")], "does not exist"),
    ):
        assert main(["baseline", "mean", "--train", str(corpus), *words, "-o", str(tmp_path / "x")]) == 1
        assert complaint in capsys.readouterr().err


def test_prepared_and_merged_sets_serve_like_a_rehearsal_corpus(corpus: Path, tmp_path: Path, capsys) -> None:
    both, made = str(tmp_path / "both"), str(tmp_path / "made")
    assert main(["data", "merge", str(corpus), "-o", both]) == 0
    assert main(["baseline", "nearest", "--train", both, both, "-o", made]) == 0
    assert main(["score", made, both]) == 0
    shards = capsys.readouterr().out.splitlines()[-1]
    assert main(["score", made, str(corpus)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == shards
    assert main(["score", made, both, "--split", "val"]) == 1
    assert "has no clips of split 'val', only test, train; name another --split" in capsys.readouterr().err
