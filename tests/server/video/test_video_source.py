"""Sound on the clock, and pictures of the pose there."""

import numpy as np
import pytest
from tests.server.sinks.receiving import RIG

from echoavatar.errors import EchoAvatarError
from echoavatar.files.avatar.avatar_renderer import Shot
from echoavatar.server.video.video_source import SoundTrack, VideoSource, prepare
from echoavatar.wire.blobs import Pose, pack_audio, pack_pose
from echoavatar.wire.messages import Flush, Motion, Rig, Sound

SMALL = Shot((64, 64), background="#ffffff", samples=1)


def standing(at: int, height: float, frames: int = 8) -> Motion:
    root = np.tile(np.float32([0, height, 0]), (frames, 1))
    return pack_pose(Pose(np.tile(np.float32([1, 0, 0, 0]), (frames, 52, 1)), root, None), at=at)


def is_there(source: VideoSource, at: float) -> bool:
    return bool(source.picture(at)[30:34, 30:34].mean() < 200)


def test_sound_is_read_across_blocks_and_is_silent_elsewhere() -> None:
    track = SoundTrack()
    track.put(100, np.arange(10, dtype=np.int16))
    track.put(110, np.arange(10, 20, dtype=np.int16))
    assert track.read(98, 24).tolist() == [0, 0, *range(20), 0, 0]
    assert track.end == 120


def test_sound_taken_back_is_silent_and_new_sound_replaces_old() -> None:
    track = SoundTrack()
    track.put(0, np.full(20, 1, np.int16))
    track.cut(15)
    assert (track.end, track.read(0, 20).sum()) == (15, 15)
    track.put(10, np.full(5, 3, np.int16))
    assert track.read(0, 20).sum() == 10 + 15


def test_sound_long_heard_is_forgotten() -> None:
    track = SoundTrack()
    for at in range(0, 240_000, 2_400):
        track.put(at, np.ones(2_400, np.int16))
    track.read(200_000, 10)
    assert track.read(0, 2_400).sum() == 0


def test_the_picture_is_of_the_pose_at_its_moment_until_that_is_taken_back() -> None:
    source = VideoSource(RIG, SMALL)
    source.take(standing(0, 0.93))
    source.take(standing(6_400, 9.0))
    assert is_there(source, 3_000)
    assert not is_there(source, 9_000)
    source.take(Flush(at=6_400, epoch=1, seg=0, heard=0))
    assert is_there(source, 9_000)


def test_before_the_first_motion_it_stands_and_its_sound_is_that_of_the_messages() -> None:
    source = VideoSource(RIG, SMALL)
    assert is_there(source, 0)
    assert source.end == 0
    source.take(Sound(at=6_400, epoch=0, seg=1, pcm=pack_audio(np.full(10, 0.5, np.float32))))
    assert source.end == 6_410
    assert source.sound(6_405, 10).tolist() == [16_384] * 5 + [0] * 5


def test_the_camera_follows_a_body_that_walks_away() -> None:
    source = VideoSource(RIG, SMALL)
    walking = standing(0, 0.93, 300)
    root = np.tile(np.float32([0, 0.93, 0]), (300, 1))
    root[:, 0] = np.linspace(0, 5, 300)
    walking = pack_pose(Pose(np.tile(np.float32([1, 0, 0, 0]), (300, 52, 1)), root, None), at=0)
    source.take(walking)
    for at in range(0, 240_000, 8_000):
        source.picture(at)
    assert (source.picture(239_000) < 200).any()


def test_other_rigs_and_unknown_characters_are_refused() -> None:
    with pytest.raises(EchoAvatarError, match="52 bones"):
        VideoSource(Rig(names=("hips",), parents=(-1,), rest=((0.0, 1.0, 0.0),)), SMALL)
    with pytest.raises(EchoAvatarError, match="nobody"):
        prepare(SMALL, "nobody")
