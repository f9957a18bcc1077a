import pytest
from lab.tests.datasets.samples import (
    SHARED,
    gesture,
    motorica_names,
    renamed,
    speech,
    write_beat2,
    write_lda,
    write_motion,
    write_pair,
)

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import write_wav
from echoavatar_lab.datasets.layouts import (
    BEAT2_SPLIT,
    LAYOUTS,
    MOTORICA_TEST,
    bandai,
    beat2,
    motorica,
    own_folder,
    survey_of,
    zeroeggs,
)


def test_aligned_recordings_with_their_styles_are_found(tmp_path):
    write_pair(tmp_path / "clean" / "001_Neutral_0_x_1_0.bvh")
    write_pair(tmp_path / "clean" / "067_Speech_2_x_1_0.bvh")
    write_pair(tmp_path / "clean" / "001_Neutral_0_mirror_x_1_0.bvh")
    write_pair(tmp_path / "original" / "001_Neutral_0.bvh")
    write_pair(tmp_path / "notes.bvh")
    found = zeroeggs(tmp_path)
    assert [(one.name, one.split, one.labels["style"]) for one in found.recordings] == [
        ("001_Neutral_0_x_1_0", "train", "Neutral"),
        ("067_Speech_2_x_1_0", "test", "Speech"),
    ]
    assert {name for name, _ in found.left_out} == {"001_Neutral_0_mirror_x_1_0", "original/001_Neutral_0", "notes"}
    assert found.recordings[0].sound == tmp_path / "clean" / "001_Neutral_0_x_1_0.wav"


def test_missing_recordings_of_a_copy_are_listed(tmp_path):
    write_pair(tmp_path / "003_Neutral_2.bvh")
    assert zeroeggs(tmp_path).missing == ["66 of 67 recordings: 001-002, 004-067"]


def test_the_validation_column_of_the_table_is_the_split(tmp_path):
    """In the table recording 1 is held out; the built-in list holds out 5 and not 1."""
    write_pair(tmp_path / "data" / "clean" / "001_Neutral_0_x_1_0.bvh")
    (tmp_path / "data" / "info.csv").write_text("anim_bvh,validation\n001_Neutral_0.bvh,TRUE\n")
    for folder in (tmp_path, tmp_path / "data" / "clean"):
        found = zeroeggs(folder)
        assert found.recordings[0].split == "test"
        assert "info.csv" in found.split_from
    (tmp_path / "data" / "info.csv").unlink()
    assert zeroeggs(tmp_path).recordings[0].split == "train"


NAME = "kthstreet_gKR_sFM_cAll_d01_mKR_ch02_song_002"


def test_dances_are_found_with_music_in_the_twin_folder(tmp_path):
    """A synthetic copy with the layout of Motorica: bvh/ at 120 fps, wav/ beside it."""
    dance = renamed(gesture(1.0, 120.0), motorica_names())
    for name in (NAME, MOTORICA_TEST[0], "something_else"):
        write_motion(tmp_path / "bvh" / f"{name}.bvh", dance)
    (tmp_path / "wav").mkdir()
    write_wav(tmp_path / "wav" / f"{NAME}.wav", speech(1.0))
    found = motorica(tmp_path)
    by_name = {one.name: one for one in found.recordings}
    assert by_name[NAME].sound == tmp_path / "wav" / f"{NAME}.wav"
    assert by_name[NAME].labels == {"genre": "krumping", "speaker": "d01"}
    assert (by_name[NAME].split, by_name[MOTORICA_TEST[0]].split) == ("train", "test")
    assert by_name[NAME].domain == "music"
    assert not by_name[MOTORICA_TEST[0]].sound.exists()
    assert by_name[MOTORICA_TEST[0]].sound.parent.name == "wav"
    assert [name for name, _ in found.left_out] == ["something_else"]
    assert found.missing == ["no clip of hiphop, popping, locking, jazz, tapping, casual"]


def test_clips_of_single_dancers_without_music_are_known_by_name(tmp_path):
    write_motion(tmp_path / "kthjazz_gTP_sFM_sngl_d02_015.bvh", gesture(0.5))
    only = motorica(tmp_path).recordings[0]
    assert only.labels == {"genre": "tapping", "speaker": "d02"}
    assert only.split == "test"


def test_ldas_tables_stand_for_dances_without_a_bvh(tmp_path):
    dance = renamed(gesture(1.0, 30.0), motorica_names())
    folder = tmp_path / "data/motorica_dance"
    for name in (
        f"{NAME}_00",
        f"{MOTORICA_TEST[5]}_01",
        f"{MOTORICA_TEST[5]}_01_mirrored",
        "kthstreet_gLO_sFM_cAll_d01_mLO_ch01_x_001_00",
    ):
        write_lda(folder / f"{name}.expmap_30fps.pkl", dance)
    (folder / f"{NAME}_00.audio29_30fps.pkl").write_bytes(b"")
    write_motion(tmp_path / "bvh" / f"{NAME}.bvh", dance)
    by_name = {one.name: one for one in motorica(tmp_path).recordings}
    assert by_name.keys() == {NAME, f"{MOTORICA_TEST[5]}_01", "kthstreet_gLO_sFM_cAll_d01_mLO_ch01_x_001_00"}
    held = by_name[f"{MOTORICA_TEST[5]}_01"]
    assert (held.split, held.labels["genre"], held.rig) == ("test", "hiphop", tmp_path / "bvh" / f"{NAME}.bvh")
    assert by_name[NAME].rig is None
    assert [name for name, _ in motorica(tmp_path).left_out] == [f"{NAME}_00", f"{MOTORICA_TEST[5]}_01_mirrored"]


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
    (folder / BEAT2_SPLIT).write_text(TABLE)
    return folder


def test_the_official_split_goes_by_recording(copy):
    for place in (copy, copy.parent):
        found = beat2(place)
        assert {one.name: one.split for one in found.recordings} == {
            "1_wayne_0_1_1": "train",
            "2_scott_0_1_1": "val",
            "2_scott_0_2_2": "test",
        }
        assert dict(found.left_out)["2_scott_0_3_3"].startswith("additional data")
        assert dict(found.left_out)["5_stewart_0_1_1"] == f"not in {BEAT2_SPLIT}"
        assert found.missing == [f"1 recordings of beat_english_v2.0.0/{BEAT2_SPLIT} without npz: 2_scott_0_9_9"]
    assert found.recordings[0].labels == {"speaker": "1", "speaker_name": "wayne", "language": "english"}
    assert found.recordings[0].sound == copy / "wave16k" / "1_wayne_0_1_1.wav"


def test_additional_recordings_train_when_asked_for(copy):
    splits = {one.name: one.split for one in beat2(copy, has_additional=True).recordings}
    assert splits["2_scott_0_3_3"] == "train"


def test_a_copy_without_its_table_has_no_official_split(copy):
    (copy / BEAT2_SPLIT).unlink()
    found = beat2(copy)
    assert {one.split for one in found.recordings} == {""}
    assert found.missing == [f"beat_english_v2.0.0/{BEAT2_SPLIT}: no official split"]


def test_a_strange_table_is_refused(copy):
    (copy / BEAT2_SPLIT).write_text("id,type\n1_wayne_0_1_1,holdout\n")
    with pytest.raises(EchoAvatarError, match="'holdout'"):
        beat2(copy)
    (copy / BEAT2_SPLIT).write_text("id,type\n")
    with pytest.raises(EchoAvatarError, match="no rows"):
        beat2(copy)


def test_a_folder_without_beat2_is_refused(tmp_path):
    with pytest.raises(EchoAvatarError, match="beat_english_v2"):
        beat2(tmp_path)


def test_content_and_style_are_read_from_the_name(tmp_path):
    write_motion(tmp_path / "dataset-2" / "dataset-2_raise-up-both-hands_not-confident_004.bvh", gesture(0.5))
    write_motion(tmp_path / "dataset-2" / "odd.bvh", gesture(0.5))
    found = bandai(tmp_path)
    assert [dict(one.labels) for one in found.recordings] == [
        {"part": "dataset-2", "content": "raise-up-both-hands", "style": "not-confident"}
    ]
    assert found.recordings[0].sound is None
    assert found.missing == ["dataset-1 is not there"]
    assert [name for name, _ in found.left_out] == ["odd"]


@pytest.mark.skipif(
    not SHARED.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
def test_the_real_subset_is_found_completely():
    found = bandai(SHARED / "bandai_namco_cc_by_nc")
    assert len(found.recordings) == 190
    assert not found.left_out
    assert not found.missing
    assert len({one.labels["style"] for one in found.recordings}) == 19


def test_names_sound_and_split_come_from_the_folders(tmp_path):
    write_pair(tmp_path / "train" / "take 1.bvh")
    write_pair(tmp_path / "test" / "take 1.bvh")
    write_motion(tmp_path / "train" / "dance.bvh", gesture(0.5))
    found = {one.name: one for one in own_folder(tmp_path).recordings}
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
    assert own_folder(tmp_path).recordings[0].sound == tmp_path / "audio" / "a.flac"


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
