import pytest
from lab.tests.datasets.samples import write_beat2

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.datasets.beat2 import SPLIT, survey

TABLE = """id,type
1_wayne_0_1_1,train
2_scott_0_1_1,val
2_scott_0_2_2,test
2_scott_0_3_3,additional
2_scott_0_9_9,train
"""


@pytest.fixture
def copy(tmp_path):
    """A synthetic copy with the layout of BEAT2."""
    folder = tmp_path / "BEAT2" / "beat_english_v2.0.0"
    for name in ("1_wayne_0_1_1", "2_scott_0_1_1", "2_scott_0_2_2", "2_scott_0_3_3", "5_stewart_0_1_1"):
        write_beat2(folder, name, 0.5)
    (folder / SPLIT).write_text(TABLE)
    return folder


def test_the_official_split_goes_by_recording(copy):
    for place in (copy, copy.parent):
        found = survey(place)
        assert {one.name: one.split for one in found.recordings} == {
            "1_wayne_0_1_1": "train",
            "2_scott_0_1_1": "val",
            "2_scott_0_2_2": "test",
        }
        assert dict(found.left_out)["2_scott_0_3_3"].startswith("additional data")
        assert dict(found.left_out)["5_stewart_0_1_1"] == f"not in {SPLIT}"
        assert found.missing == [f"1 recordings of beat_english_v2.0.0/{SPLIT} without npz: 2_scott_0_9_9"]
    assert found.recordings[0].labels == {"speaker": "1", "speaker_name": "wayne", "language": "english"}
    assert found.recordings[0].sound == copy / "wave16k" / "1_wayne_0_1_1.wav"


def test_additional_recordings_train_when_asked_for(copy):
    splits = {one.name: one.split for one in survey(copy, has_additional=True).recordings}
    assert splits["2_scott_0_3_3"] == "train"


def test_a_copy_without_its_table_has_no_official_split(copy):
    (copy / SPLIT).unlink()
    found = survey(copy)
    assert {one.split for one in found.recordings} == {""}
    assert found.missing == [f"beat_english_v2.0.0/{SPLIT}: no official split"]


def test_a_strange_table_is_refused(copy):
    (copy / SPLIT).write_text("id,type\n1_wayne_0_1_1,holdout\n")
    with pytest.raises(EchoAvatarError, match="'holdout'"):
        survey(copy)
    (copy / SPLIT).write_text("id,type\n")
    with pytest.raises(EchoAvatarError, match="no rows"):
        survey(copy)


def test_a_folder_without_beat2_is_refused(tmp_path):
    with pytest.raises(EchoAvatarError, match="beat_english_v2"):
        survey(tmp_path)
