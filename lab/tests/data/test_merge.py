from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.clips import MUSIC, clip, folder

from echoavatar.cli import main
from echoavatar.errors import MotionError
from echoavatar_lab.data import Corpus
from echoavatar_lab.data.merge import merge


@pytest.fixture
def sets(tmp_path: Path) -> tuple[Path, Path]:
    talk = folder(tmp_path / "talk", [clip("a", 60), clip("b", 80, split="train")], is_corpus=True)
    dance = folder(tmp_path / "dance", [clip("c", 70, size=0.6, kind=MUSIC, split="train")], is_corpus=True)
    return talk, dance


def test_clips_are_what_they_were_and_training_clips_have_mirror_images(sets, tmp_path: Path) -> None:
    both = merge(sets, tmp_path / "both")
    assert both.names() == ["a", "b", "b.mirror", "c", "c.mirror"]
    assert both.names("test") == ["a"]
    both.verify()
    for place, names in zip(sets, ("ab", "c"), strict=True):
        for name in names:
            before, after = Corpus(place).load(name), both.load(name)
            assert before.split == after.split
            for field in ("audio", "rotations", "root", "domain"):
                np.testing.assert_array_equal(getattr(before, field), getattr(after, field))


def test_a_set_of_shards_is_linked_and_its_terms_are_kept(sets, tmp_path: Path) -> None:
    one = merge(sets[:1], tmp_path / "one")
    both = merge([tmp_path / "one", sets[1]], tmp_path / "both")
    both.verify()
    assert both.names(has_mirrored=False) == ["a", "b", "c"]
    np.testing.assert_array_equal(both.load("b.mirror").rotations, one.load("b.mirror").rotations)
    shard = tmp_path / "both/shards/00000.root.npy"
    assert shard.stat().st_ino == (tmp_path / "one/shards/00000.root.npy").stat().st_ino
    assert set(both.manifest.info["parts"]) == {"one", "dance"}


def test_the_command_merges_and_tells_what_it_holds(sets, tmp_path: Path, capsys) -> None:
    assert main(["data", "merge", *map(str, sets), "-o", str(tmp_path / "both")]) == 0
    assert "3 clips" in capsys.readouterr().out
    assert main(["data", "merge", *map(str, sets), "-o", str(tmp_path / "both")]) == 1
    assert "holds something already" in capsys.readouterr().err


def test_sets_that_do_not_fit_are_named(sets, tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="both have a clip 'a'"):
        merge([sets[0], sets[0]], tmp_path / "x")
    with pytest.raises(MotionError, match="not a corpus"):
        merge([sets[0], tmp_path], tmp_path / "x")
    assert not (tmp_path / "x").exists()
