from pathlib import Path

import pytest
from lab.tests.datasets.samples import write_pair
from pydantic import ValidationError

from echoavatar_lab.datasets.source import Recording, SetOptions, files_below, with_splits


def recording(name: str, split: str = "") -> Recording:
    return Recording(name, Path(f"{name}.bvh"), None, split=split)


def test_recordings_without_a_split_are_held_out_one_in_ten():
    splits = {one.name: one.split for one in with_splits([recording(f"{n:02d}") for n in range(20)], None)}
    assert [name for name, split in splits.items() if split == "test"] == ["09", "19"]


def test_published_splits_stay_unless_another_is_asked_for():
    recordings = [recording("a", "test"), recording("b", "train"), recording("c", "val")]
    assert [one.split for one in with_splits(recordings, None)] == ["test", "train", "val"]
    assert [one.split for one in with_splits(recordings, 2)] == ["train", "test", "train"]
    assert [one.split for one in with_splits(recordings, 0)] == ["train"] * 3


def test_hidden_files_are_not_looked_at(tmp_path):
    write_pair(tmp_path / ".trash" / "a.bvh")
    (tmp_path / "._b.bvh").write_text("resource fork")
    assert files_below(tmp_path, ".bvh") == []


def test_only_options_that_change_clips_change_the_digest():
    plain = SetOptions()
    assert plain.digest() == SetOptions(shard_minutes=3, sound="any", test_every=4, mirror=False).digest()
    for other in (SetOptions(rig="native"), SetOptions(fingers="keep"), SetOptions(seed=1)):
        assert other.digest() != plain.digest()


def test_invalid_options_are_refused():
    with pytest.raises(ValidationError):
        SetOptions(rig="mine")
    with pytest.raises(ValidationError):
        SetOptions(length_tolerance=0)
