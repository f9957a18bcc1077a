from lab.tests.datasets.samples import gesture, speech, write_motion, write_pair

from echoavatar.models.audio import write_wav
from echoavatar_lab.datasets.folder import survey


def test_names_sound_and_split_come_from_the_folders(tmp_path):
    write_pair(tmp_path / "train" / "take 1.bvh")
    write_pair(tmp_path / "test" / "take 1.bvh")
    write_motion(tmp_path / "train" / "dance.bvh", gesture(0.5))
    found = {one.name: one for one in survey(tmp_path).recordings}
    assert set(found) == {"test__take_1", "train__take_1", "train__dance"}
    assert found["test__take_1"].split == "test"
    assert found["train__dance"].domain == "music"
    assert found["train__take_1"].domain == "speech"
    assert found["train__dance"].sound == tmp_path / "train" / "dance.wav"
    assert not found["train__dance"].sound.exists()


def test_sound_may_lie_in_a_twin_folder_in_any_format(tmp_path):
    write_motion(tmp_path / "bvh" / "a.bvh", gesture(0.5))
    (tmp_path / "audio").mkdir()
    write_wav(tmp_path / "audio" / "a.flac", speech(0.5))
    assert survey(tmp_path).recordings[0].sound == tmp_path / "audio" / "a.flac"
