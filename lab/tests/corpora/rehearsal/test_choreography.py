import numpy as np
import pytest

from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, Controls, neutral
from echoavatar_lab.corpora.rehearsal.choreography import choreograph, switched
from echoavatar_lab.corpora.sound import SoundTrack


@pytest.fixture(scope="module")
def show(talk_then_music: SoundTrack) -> Controls:
    return choreograph(talk_then_music, 3)


def elsewhere(frames: int) -> Controls:
    """A body half a step to the side with raised, circling hands and a bouncing pelvis."""
    controls = neutral(frames)
    clock = np.arange(frames) / 30
    controls.foot_position[..., 0] += 0.12
    controls.pelvis_position[:, 0] += 0.12
    controls.pelvis_position[:, 1] -= 0.05 + 0.03 * np.sin(2 * np.pi * 2 * clock)
    controls.wrist[:] = (0.1, 0.0, 0.35)
    controls.wrist[..., 1] += 0.1 * np.sin(2 * np.pi * clock)[:, None]
    return controls


def test_switching_keeps_the_past_and_reaches_the_new_motion():
    before, after = neutral(120), elsewhere(120)
    joined = switched(before, after, at=40, seconds=1.0)
    np.testing.assert_array_equal(joined.packed()[:40], before.packed()[:40])
    np.testing.assert_allclose(joined.packed()[85:], after.packed()[85:], atol=1e-5)


def test_switching_has_no_jump_in_speed():
    frames = 120
    joined = switched(elsewhere(frames), neutral(frames), at=50, seconds=0.9)
    for curve in (joined.wrist, joined.pelvis_position, joined.foot_position):
        assert np.abs(np.diff(curve, axis=0)).max() * 30 < 2.0
        assert np.abs(np.diff(curve, 2, axis=0)).max() * 900 < 15.0


def test_feet_change_place_one_after_the_other_and_in_the_air():
    joined = switched(neutral(120), elsewhere(120), at=40, seconds=1.0)
    moving = np.linalg.norm(np.diff(joined.foot_position[..., [0, 2]], axis=0), axis=-1) > 3e-4
    height = joined.foot_position[..., 1]
    lifted = np.maximum(height[1:], height[:-1]) > ANKLE_HEIGHT + 1e-4
    assert moving.any(axis=0).all()
    assert not (moving & ~lifted).any()
    assert (height > ANKLE_HEIGHT + 1e-4).all(axis=1).sum() == 0
    assert joined.foot_position[..., 1].min() >= ANKLE_HEIGHT - 1e-6


def test_dancing_starts_soon_after_the_music_and_stops_with_it(show: Controls):
    """After the music it ends its move, steps home within 2.6 s, and stands."""
    pelvis = np.linalg.norm(np.diff(show.pelvis_position, axis=0), axis=-1) * 30
    speech, music, silence = pelvis[:90], pelvis[round(4.4 * 30) : 330], pelvis[round(13.8 * 30) :]
    assert music.mean() > 4 * speech.mean()
    assert pelvis[round(3.4 * 30) : round(4.4 * 30)].max() > 2 * speech.mean()
    assert silence.mean() < 0.1 * music.mean()


def test_the_same_seed_gives_the_same_show(talk_then_music: SoundTrack, show: Controls):
    np.testing.assert_array_equal(choreograph(talk_then_music, 3).packed(), show.packed())


def test_no_speed_jumps_anywhere(show: Controls):
    for curve in (show.pelvis_position, show.wrist, show.head):
        assert np.abs(np.diff(curve, 2, axis=0)).max() * 900 < 80


def test_a_track_without_music_has_no_dance(talk: SoundTrack):
    assert len(choreograph(talk, 0)) == 456


@pytest.mark.parametrize("left", [2, 3, 5, 9, 13, 20, 30])
def test_music_may_end_just_before_the_track_does(left: int):
    """A late switch used to place a foot step after the last frame."""
    joined = switched(neutral(60), elsewhere(60), at=60 - left, seconds=1.0)
    assert len(joined) == 60
    assert np.abs(np.diff(joined.packed(), axis=0)).max() < 0.2
