from lab.tests.datasets.samples import gesture, motorica_names, renamed, speech, write_lda, write_motion

from echoavatar.models.audio import write_wav
from echoavatar_lab.datasets.motorica import TEST, survey

NAME = "kthstreet_gKR_sFM_cAll_d01_mKR_ch02_song_002"


def test_dances_are_found_with_music_in_the_twin_folder(tmp_path):
    """A synthetic copy with the layout of Motorica: bvh/ at 120 fps, wav/ beside it."""
    dance = renamed(gesture(1.0, 120.0), motorica_names())
    for name in (NAME, TEST[0], "something_else"):
        write_motion(tmp_path / "bvh" / f"{name}.bvh", dance)
    (tmp_path / "wav").mkdir()
    write_wav(tmp_path / "wav" / f"{NAME}.wav", speech(1.0))
    found = survey(tmp_path)
    by_name = {one.name: one for one in found.recordings}
    assert by_name[NAME].sound == tmp_path / "wav" / f"{NAME}.wav"
    assert by_name[NAME].labels == {"genre": "krumping", "speaker": "d01"}
    assert (by_name[NAME].split, by_name[TEST[0]].split) == ("train", "test")
    assert by_name[NAME].domain == "music"
    assert not by_name[TEST[0]].sound.exists()
    assert by_name[TEST[0]].sound.parent.name == "wav"
    assert [name for name, _ in found.left_out] == ["something_else"]
    assert found.missing == ["no clip of hiphop, popping, locking, jazz, tapping, casual"]


def test_clips_of_single_dancers_without_music_are_known_by_name(tmp_path):
    write_motion(tmp_path / "kthjazz_gTP_sFM_sngl_d02_015.bvh", gesture(0.5))
    only = survey(tmp_path).recordings[0]
    assert only.labels == {"genre": "tapping", "speaker": "d02"}
    assert only.split == "test"


def test_ldas_tables_stand_for_dances_without_a_bvh(tmp_path):
    dance = renamed(gesture(1.0, 30.0), motorica_names())
    folder = tmp_path / "data/motorica_dance"
    for name in (
        f"{NAME}_00",
        f"{TEST[5]}_01",
        f"{TEST[5]}_01_mirrored",
        "kthstreet_gLO_sFM_cAll_d01_mLO_ch01_x_001_00",
    ):
        write_lda(folder / f"{name}.expmap_30fps.pkl", dance)
    (folder / f"{NAME}_00.audio29_30fps.pkl").write_bytes(b"")
    write_motion(tmp_path / "bvh" / f"{NAME}.bvh", dance)
    by_name = {one.name: one for one in survey(tmp_path).recordings}
    assert by_name.keys() == {NAME, f"{TEST[5]}_01", "kthstreet_gLO_sFM_cAll_d01_mLO_ch01_x_001_00"}
    held = by_name[f"{TEST[5]}_01"]
    assert (held.split, held.labels["genre"], held.rig) == ("test", "hiphop", tmp_path / "bvh" / f"{NAME}.bvh")
    assert by_name[NAME].rig is None
    assert [name for name, _ in survey(tmp_path).left_out] == [f"{NAME}_00", f"{TEST[5]}_01_mirrored"]
