import numpy as np
import pytest

from echoavatar_lab.models.face.clip import FaceClip
from echoavatar_lab.models.face.tempo import at_speed, resample_curves, stretch


def clicks_and_hum(seconds: float = 2.0) -> np.ndarray:
    time = np.arange(int(seconds * 24_000)) / 24_000
    loud = np.where(np.abs((time % 0.5) - 0.25) < 0.05, 1.0, 0.02)
    return (0.3 * loud * np.sin(2 * np.pi * 200 * time)).astype(np.float32)


@pytest.mark.parametrize("speed", [0.9, 1.1])
def test_pitch_stays_and_time_moves(speed):
    """Bursts every 0.5 s come every 0.5 / speed s; the strongest frequency remains 200 Hz."""
    sound = clicks_and_hum()
    slow = stretch(sound, round(len(sound) / speed))
    assert len(slow) == round(len(sound) / speed)
    spectrum = np.abs(np.fft.rfft(slow * np.hanning(len(slow))))
    assert abs(np.argmax(spectrum) * 24_000 / len(slow) - 200) < 3
    for burst in range(4):
        middle = (burst + 0.5) * 0.5 / speed
        near = slow[int((middle - 0.1) * 24_000) : int((middle + 0.1) * 24_000)] ** 2
        found = middle - 0.1 + (near * np.arange(len(near))).sum() / near.sum() / 24_000
        assert abs(found - middle) < 0.012
    assert abs(slow.std() / sound.std() - 1) < 0.1


def test_the_same_length_is_nearly_the_same_sound():
    sound = clicks_and_hum()
    assert np.abs(stretch(sound, len(sound)) - sound)[1000:-1000].max() < 0.02


def test_curves_follow_a_cubic():
    """A parabola is its own spline: the middles of the new frames lie on it."""
    t = np.arange(30) + 0.5
    curves = ((t / 30 - 0.5) ** 2)[:, None]
    n = np.arange(20) + 0.5
    np.testing.assert_allclose(resample_curves(curves, 20)[2:-2, 0], ((n / 20 - 0.5) ** 2)[2:-2], atol=1e-6)
    assert resample_curves(np.ones((1, 3)), 4).shape == (4, 3)


def test_sound_and_face_stay_together():
    clip = FaceClip("a", clicks_and_hum(), np.zeros((60, 52), np.float32))
    fast = at_speed(clip, 1.1)
    assert len(fast.curves) == 55
    assert len(fast.audio) == 55 * 800
    assert at_speed(clip, 1.0) is clip
