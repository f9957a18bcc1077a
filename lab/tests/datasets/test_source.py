from pathlib import Path

import pytest
from lab.tests.datasets.samples import write_beat2, write_pair

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.datasets.source import LAYOUTS, Recording, files_below, survey_of, with_splits


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


def test_only_names_that_match_are_wanted(tmp_path):
    write_pair(tmp_path / "a1.bvh")
    write_pair(tmp_path / "b1.bvh")
    found = survey_of("bvh", tmp_path, only=["a*"])
    assert [one.name for one in found.recordings] == ["a1"]
    assert found.left_out == (("b1", "not among --only"),)


def test_speakers_are_chosen_by_number_or_name(tmp_path):
    for name in ("1_wayne_0_1_1", "2_scott_0_1_1", "12_zhao_0_1_1"):
        write_beat2(tmp_path, name, 0.5)
    for who in ("2", "scott"):
        assert [one.name for one in survey_of("beat2", tmp_path, speakers=[who]).recordings] == ["2_scott_0_1_1"]


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(EchoAvatarError, match="is not a folder"):
        survey_of("bvh", tmp_path / "gone")
    with pytest.raises(EchoAvatarError, match="no recording of zeroeggs"):
        survey_of("zeroeggs", tmp_path)
    write_pair(tmp_path / "a.bvh")
    with pytest.raises(EchoAvatarError, match=r"all 1 left out: not among --only"):
        survey_of("bvh", tmp_path, only=["z"])


def test_every_layout_says_its_terms(tmp_path):
    write_pair(tmp_path / "001_Neutral_0.bvh")
    assert set(LAYOUTS) == {"zeroeggs", "motorica", "beat2", "bandai", "bvh"}
    terms = survey_of("zeroeggs", tmp_path).terms
    assert terms.licence == "CC BY-NC-ND 4.0"
    assert "nothing" in terms.may_ship


def test_hidden_files_are_not_looked_at(tmp_path):
    write_pair(tmp_path / ".trash" / "a.bvh")
    (tmp_path / "._b.bvh").write_text("resource fork")
    assert files_below(tmp_path, ".bvh") == []
