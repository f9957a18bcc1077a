"""Sounds and motion of the owner: cut alike, and refused by name."""

import numpy as np
import pytest
from studio.tests import canned

from echoavatar.errors import AudioError, EchoAvatarError, MotionError
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.formats.tables import write_npz
from echoavatar.motion.kinematics.motion import resample
from echoavatar_studio.clips import save_sound
from echoavatar_studio.settings import SoundChoice, SystemChoice
from echoavatar_studio.sources import from_folder, inside, perform, read_sounds


@pytest.fixture
def place(tmp_path):
    for number, name in enumerate(("one", "two")):
        save_sound(tmp_path / "sounds" / f"{name}.flac", canned.hum(2.0, 200 + 50 * number))
    (tmp_path / "clips").mkdir()
    write_npz(tmp_path / "clips" / "one.npz", canned.moving(2.0, 1.0), face=np.full((60, 52), 0.5, np.float32))
    motion = canned.moving(2.0, 1.5)
    write_bvh(tmp_path / "clips" / "two.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    return tmp_path


def test_sound_and_motion_are_cut_alike(place):
    cuts = read_sounds([SoundChoice(path="sounds", category="gesture", start=0.5)], place, seconds=1.0)
    assert [(cut.name, len(cut.audio)) for cut in cuts] == [("one", 24_000), ("two", 24_000)]
    folder = perform(SystemChoice(name="A", clips="clips"), place)
    (one, seed), (two, _) = (folder(cut, 0) for cut in cuts)
    assert seed is None
    whole = canned.moving(2.0, 1.0)
    np.testing.assert_allclose(one.motion.rotations, whole.rotations[15:45], atol=1e-6)
    assert one.face is not None
    assert one.face.shape == (30, 52)
    assert (two.motion.frames, two.face) == (30, None)


@pytest.mark.parametrize("fps", [25.0, 60.0])
def test_a_face_at_another_rate_keeps_its_time(place, fps):
    clip = resample(canned.moving(2.0, 1.0), fps)
    face = np.tile(np.arange(clip.frames)[:, None] / (2 * fps), (1, 52)).astype(np.float32)
    write_npz(place / "clips" / "one.npz", clip, face=face)
    sound = SoundChoice(path="sounds/one.flac", category="gesture", start=0.5)
    (cut,) = read_sounds([sound], place, seconds=1.0)
    shown = from_folder(place / "clips", "A", cut)
    assert shown.face is not None
    np.testing.assert_allclose(shown.face[:, 0], np.arange(15, 45) / 60, atol=1e-5)
    write_npz(place / "clips" / "one.npz", clip, face=face[:-1])
    assert from_folder(place / "clips", "A", cut).face is None


def test_the_same_name_twice_is_told_apart(place):
    choices = [SoundChoice(path="sounds/one.flac", category="gesture", start=at) for at in (0.0, 1.0)]
    assert [cut.name for cut in read_sounds(choices, place, seconds=1.0)] == ["one", "one 2"]


def test_what_cannot_be_used_is_named(place):
    one = SoundChoice(path="sounds/one.flac", category="gesture")
    with pytest.raises(AudioError, match=r"one\.flac has 2\.0 s of sound"):
        read_sounds([one], place, seconds=3.0)
    with pytest.raises(AudioError, match="there is no sound"):
        read_sounds([SoundChoice(path="none.wav", category="dance")], place, seconds=1.0)
    with pytest.raises(AudioError, match="holds no sound"):
        read_sounds([SoundChoice(path="clips", category="dance")], place, seconds=1.0)
    with pytest.raises(MotionError, match="not a folder"):
        perform(SystemChoice(name="A", clips="none"), place)
    (cut,) = read_sounds([one], place, seconds=2.0)
    with pytest.raises(MotionError, match="has no clip three.npz"):
        from_folder(place / "clips", "A", cut._replace(stem="three"))
    write_npz(place / "clips" / "one.npz", canned.moving(1.0, 1.0))
    with pytest.raises(MotionError, match=r"lasts 1\.0 s"):
        from_folder(place / "clips", "A", cut)


def test_paths_stay_in_the_library(place):
    inside(place, ["clips", "sounds/one.flac"])
    with pytest.raises(EchoAvatarError, match="not in the studio's library"):
        inside(place, ["clips/../../elsewhere"])
