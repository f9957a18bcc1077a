import numpy as np
import pytest
from lab.tests.corpora.capture.people import library

from echoavatar.models.generator.manner import draw_manner
from echoavatar_lab.corpora.gesture.idle import breathing, idle, resting_hands, with_hands
from echoavatar_lab.corpora.gesture.speakers import resting_of
from echoavatar_lab.corpora.sound import SoundTrack, Span

FRAMES = 900
QUIET = SoundTrack(np.zeros(FRAMES * 800, np.float32), spans=(Span(0.0, 30.0, "silence"),))


def test_the_same_seed_is_the_same_person():
    np.testing.assert_array_equal(idle(QUIET, 4).packed(), idle(QUIET, 4).packed())


@pytest.mark.parametrize("seed", range(4))
def test_everything_moves_and_nothing_hurries(seed: int):
    controls = idle(QUIET, seed)
    wrist = np.linalg.norm(np.diff(controls.wrist, axis=0), axis=-1) * 30
    assert 0 < wrist.mean() < 0.03
    assert wrist.max() < 0.08
    assert np.ptp(controls.fingers[..., :5], axis=0).min() > 0.005
    assert np.ptp(controls.spine[:, 1]) > 0.015
    assert np.abs(np.diff(controls.head, axis=0)).max() * 30 < 1.0


def test_breath_has_the_given_rate():
    """0.25 Hz over 120 s crosses zero upwards about 30 times."""
    breath = breathing(3600, 0.25, np.random.default_rng(0))
    upwards = int(((breath[:-1] < 0) & (breath[1:] >= 0)).sum())
    assert 25 <= upwards <= 35
    assert np.abs(breath).max() <= 1


def test_with_hands_gives_the_body_these_hands():
    controls = idle(QUIET, 1)
    np.testing.assert_array_equal(with_hands(controls, controls.hands()).packed(), controls.packed())
    assert not np.array_equal(resting_hands("sides"), resting_hands("clasped"))


def test_a_captured_body_waits_in_silence_and_sways_from_when_speech_is_heard(talk: SoundTrack):
    """The talk's first phrase lasts from 2.0 to 4.24 s; the body answers after 0.15 s."""
    people = library()
    body = idle(talk, 5, people)
    assert len(body) == 456
    speed = np.abs(np.diff(body.pelvis_position[:, 0])) * 30
    assert speed[90:280].mean() > 2 * speed[:60].mean()
    rest = resting_hands(resting_of(draw_manner(5)))
    np.testing.assert_allclose(body.hands()[120:130, :, :7], np.broadcast_to(rest[:, :7], (10, 2, 7)), atol=0.02)
    np.testing.assert_array_equal(idle(talk, 5, people).packed(), body.packed())
