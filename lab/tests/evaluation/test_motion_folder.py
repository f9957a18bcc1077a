from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.clips import MUSIC, SPEECH, clicks, clip, folder
from tests.motion.kinematics.samples import swaying

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.models.audio import write_wav
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.formats.tables import read_npz, write_npz
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.motion_folder import (
    ReadOptions,
    made_how,
    make_motion,
    motion_files,
    read_motion_file,
    read_pairs,
)


def refused(*words: str):
    return pytest.raises(EchoAvatarError, match=".*".join(words))


def test_clips_bvh_and_npz_are_matched_by_name(tmp_path: Path) -> None:
    """True: clips of a corpus. Made: a BVH file and what `animate` writes. Sound and labels come with the clips."""
    truth = folder(tmp_path / "corpus", [clip("a"), clip("b", kind=MUSIC)], is_corpus=True)
    made = tmp_path / "made"
    made.mkdir()
    motion = swaying(240)
    write_bvh(made / "a.bvh", HUMANOID, motion.rotations, motion.root, 30)
    write_npz(made / "b.npz", motion)
    pairs = read_pairs(made, truth, ReadOptions())
    assert [pair.name for pair in pairs] == ["a", "b"]
    assert [pair.domain[0] for pair in pairs] == [SPEECH, MUSIC]
    assert all(pair.made.frames == pair.true.frames == 240 for pair in pairs)
    assert all(pair.audio is not None and len(pair.audio) == 240 * 800 for pair in pairs)
    np.testing.assert_allclose(pairs[0].made.pose().positions, pairs[0].true.pose().positions, atol=2e-3)


def test_sound_is_found_in_its_folder_or_beside_the_motion(tmp_path: Path) -> None:
    motion, sound = swaying(60), clicks(60, 0.5)
    for name in ("made", "music_true", "sounds"):
        (tmp_path / name).mkdir()
    made, true = tmp_path / "made", tmp_path / "music_true"
    for place in (made, true):
        write_npz(place / "a.npz", motion)
    with refused("clip a has no audio", "a.wav next to it", "--audio", "--no-audio"):
        read_pairs(made, true, ReadOptions())
    assert read_pairs(made, true, ReadOptions(needs_audio=False))[0].audio is None
    write_wav(tmp_path / "sounds" / "a.wav", sound)
    given = read_pairs(made, true, ReadOptions(audio=tmp_path / "sounds"))[0]
    assert given.domain[0] == MUSIC  # by the folder's name
    assert read_pairs(made, true, ReadOptions(audio=tmp_path / "sounds", kind=SPEECH))[0].domain[0] == SPEECH
    write_wav(true / "a.wav", sound)
    np.testing.assert_allclose(read_pairs(made, true, ReadOptions())[0].audio, given.audio, atol=1e-4)


def test_folders_that_do_not_match_are_named(tmp_path: Path) -> None:
    one = folder(tmp_path / "one", [clip("a")])
    two = folder(tmp_path / "two", [clip("a"), clip("b"), clip("c")])
    with refused("one lacks 2 of the 3 clips in .*two, for example b", "--common"):
        read_pairs(one, two, ReadOptions())
    with refused("one lacks"):
        read_pairs(two, one, ReadOptions())
    assert [pair.name for pair in read_pairs(two, one, ReadOptions(is_common=True))] == ["a"]
    other = folder(tmp_path / "other", [clip("z")])
    with refused("no file name in common"):
        read_pairs(one, other, ReadOptions(is_common=True))


def test_empty_missing_and_double_are_named(tmp_path: Path) -> None:
    with refused("not a folder"):
        motion_files(tmp_path / "none")
    with refused("holds no motion", "another folder"):
        motion_files(tmp_path)
    motion = swaying(10)
    write_bvh(tmp_path / "a.bvh", HUMANOID, motion.rotations, motion.root, 30)
    write_npz(tmp_path / "a.npz", motion)
    with refused("two clips named a"):
        motion_files(tmp_path)


def test_another_rate_is_refused_or_resampled(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", swaying(121, fps=60.0))
    with refused("a.npz is at 60 frames", "--resample"):
        read_motion_file(tmp_path / "a.npz")
    assert read_motion_file(tmp_path / "a.npz", is_resampling=True).motion.frames == 61


def test_values_that_are_not_finite_and_damage_name_the_file(tmp_path: Path) -> None:
    good = tmp_path / "a.npz"
    write_npz(good, swaying(30))
    with np.load(good) as stored:
        arrays = dict(stored)
    arrays["root"][3, 1] = np.nan
    np.savez(good, **arrays)
    with refused("a.npz", "not finite"):
        read_motion_file(good)
    good.write_bytes(b"nothing")
    with refused("a.npz", "damaged"):
        read_motion_file(good)


def test_lengths_that_differ_are_named(tmp_path: Path) -> None:
    long, short = folder(tmp_path / "long", [clip("a", 120)]), folder(tmp_path / "short", [clip("a", 90)])
    with refused("clip a: 90 frames were generated and 120 are true"):
        read_pairs(short, long, ReadOptions())
    (tmp_path / "sounds").mkdir()
    write_wav(tmp_path / "sounds" / "a.wav", clicks(60, 0.5))
    with refused("clip a: the audio lasts 2.00 s and the motion 4.00 s", "frame rate"):
        read_pairs(long, long, ReadOptions(audio=tmp_path / "sounds"))
    with refused("holds no audio"):
        read_pairs(long, long, ReadOptions(audio=tmp_path))
    with refused("not a folder"):
        read_pairs(long, long, ReadOptions(audio=tmp_path / "none"))


def test_every_true_clip_gets_motion_for_its_sound_and_a_note(tmp_path: Path, tiny_bundle: Path) -> None:
    true = folder(tmp_path / "true", [clip("a", 60), clip("b", 90)], is_corpus=True)
    pipeline, note = Pipeline(load_bundle(tiny_bundle).running("paper")), {"runtime": "paper", "seed": 3}
    made = tmp_path / "made"
    assert make_motion(pipeline, note, true, made, ReadOptions(), seed=3) == 2
    assert [pair.made.frames for pair in read_pairs(made, true, ReadOptions())] == [60, 90]
    assert made_how(made) == note
    before = (made / "b.npz").read_bytes()
    (made / "a.npz").unlink()
    assert make_motion(pipeline, note, true, made, ReadOptions(), seed=3) == 1  # goes on
    assert (made / "b.npz").read_bytes() == before
    assert read_npz(made / "a.npz").frames == 60


def test_motion_that_was_made_otherwise_is_never_mixed(tmp_path: Path, tiny_bundle: Path) -> None:
    true = folder(tmp_path / "true", [clip("a", 30)], is_corpus=True)
    pipeline = Pipeline(load_bundle(tiny_bundle).running("paper"))
    make_motion(pipeline, {"runtime": "paper"}, true, tmp_path / "made", ReadOptions())
    with pytest.raises(MotionError, match="made was made with .*paper.*default"):
        make_motion(pipeline, {"runtime": "default"}, true, tmp_path / "made", ReadOptions())
    others = folder(tmp_path / "others", [clip("a", 30)])
    with pytest.raises(MotionError, match=r"without made\.json"):
        make_motion(pipeline, {"runtime": "paper"}, true, others, ReadOptions())
    assert made_how(others) is None
    (tmp_path / "made/made.json").write_text("{")
    with pytest.raises(MotionError, match="damaged"):
        made_how(tmp_path / "made")
