from pathlib import Path

import pytest
from tests.models.fingers.moving import waving

from echoavatar.checkpoint import read_card
from echoavatar.cli import main
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.data import Clip, write_manifest
from echoavatar_lab.data.corpus import clip_path

SMALL = ["--steps", "3", "--batch", "2", "--width", "16", "--layers", "1"]


def corpus(folder: Path) -> Path:
    """Two clips of moving hands, one for testing."""
    import numpy as np

    for seed, split in ((0, "train"), (1, "test")):
        motion = waving(70, seed)
        clip = Clip(
            name=f"c{seed}",
            audio=np.zeros(70 * 800, np.float32),
            rotations=motion.rotations,
            root=motion.root,
            domain=np.zeros(70, np.uint8),
            split=split,
        )
        clip.save(clip_path(folder, clip.name))
    write_manifest(folder)
    return folder


def takes(folder: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    folder.mkdir()
    motion = waving(20)
    write_bvh(folder / "take.bvh", motion.skeleton, motion.rotations, motion.root, 30)
    return folder


def test_a_corpus_and_takes_train_a_model_with_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, more = corpus(tmp_path / "corpus"), takes(tmp_path / "takes", capsys)
    words = [str(source), "-o", str(tmp_path / "run"), "--recordings", str(more), *SMALL]
    assert main(["train", "fingers", *words]) == 0
    card = read_card(tmp_path / "run")
    assert str(card["command"]).startswith("echoavatar train fingers")
    assert "mean pose" in card["scores"]  # type: ignore[operator]
    assert card["step"] == 3


def test_a_folder_of_takes_will_do_and_an_empty_one_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = takes(tmp_path / "takes", capsys)
    assert main(["train", "fingers", str(more), "-o", str(tmp_path / "run"), *SMALL]) == 0
    (tmp_path / "empty").mkdir()
    assert main(["train", "fingers", str(tmp_path / "empty"), "-o", str(tmp_path / "x")]) == 1
    assert "neither a corpus nor .bvh files" in capsys.readouterr().err
