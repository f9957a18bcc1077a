from lab.tests.datasets.samples import write_pair

from echoavatar_lab.datasets.zeroeggs import survey


def test_aligned_recordings_with_their_styles_are_found(tmp_path):
    write_pair(tmp_path / "clean" / "001_Neutral_0_x_1_0.bvh")
    write_pair(tmp_path / "clean" / "067_Speech_2_x_1_0.bvh")
    write_pair(tmp_path / "clean" / "001_Neutral_0_mirror_x_1_0.bvh")
    write_pair(tmp_path / "original" / "001_Neutral_0.bvh")
    write_pair(tmp_path / "notes.bvh")
    found = survey(tmp_path)
    assert [(one.name, one.split, one.labels["style"]) for one in found.recordings] == [
        ("001_Neutral_0_x_1_0", "train", "Neutral"),
        ("067_Speech_2_x_1_0", "test", "Speech"),
    ]
    assert {name for name, _ in found.left_out} == {"001_Neutral_0_mirror_x_1_0", "original/001_Neutral_0", "notes"}
    assert found.recordings[0].sound == tmp_path / "clean" / "001_Neutral_0_x_1_0.wav"


def test_missing_recordings_of_a_copy_are_listed(tmp_path):
    write_pair(tmp_path / "003_Neutral_2.bvh")
    assert survey(tmp_path).missing == ["66 of 67 recordings: 001-002, 004-067"]


def test_the_validation_column_of_the_table_is_the_split(tmp_path):
    """In the table recording 1 is held out; the built-in list holds out 5 and not 1."""
    write_pair(tmp_path / "data" / "clean" / "001_Neutral_0_x_1_0.bvh")
    (tmp_path / "data" / "info.csv").write_text("anim_bvh,validation\n001_Neutral_0.bvh,TRUE\n")
    for folder in (tmp_path, tmp_path / "data" / "clean"):
        found = survey(folder)
        assert found.recordings[0].split == "test"
        assert "info.csv" in found.split_from
    (tmp_path / "data" / "info.csv").unlink()
    assert survey(tmp_path).recordings[0].split == "train"
