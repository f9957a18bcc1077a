import numpy as np
import pytest
from lab.tests.datasets.samples import speech

from echoavatar_lab.datasets.labels import sound_labels


def test_pauses_are_silence_and_syllables_are_stresses():
    sound = np.concatenate([speech(3.0), np.zeros(48_000, np.float32), speech(3.0)])
    domain, events = sound_labels(sound, "speech")
    assert len(domain) == 240
    assert (domain[10:80] == 1).all()
    assert (domain[100:145] == 0).all()
    assert (domain[165:230] == 1).all()
    stresses = np.array(events["stress"])
    assert len(stresses) > 3
    assert not ((stresses > 3.2) & (stresses < 4.8)).any()


def test_beats_of_music_are_found():
    """A click every half second."""
    sound = np.zeros(24_000 * 12, np.float32)
    for k in range(24):
        sound[k * 12_000 : k * 12_000 + 1200] = 0.5 * np.sin(np.arange(1200) / 3) * np.linspace(1, 0, 1200)
    domain, events = sound_labels(sound, "music")
    assert (domain == 2).mean() > 0.9
    assert np.median(np.diff(events["beats"])) == pytest.approx(0.5, abs=0.02)


def test_silence_and_very_short_sound_have_no_labels():
    for sound in (np.zeros(72_000, np.float32), speech(0.5)):
        domain, events = sound_labels(sound, "speech")
        assert len(domain) == len(sound) // 800
        assert not domain.any()
        assert events == {}
