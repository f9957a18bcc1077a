from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from echoavatar.models.generator.manner import Manner, draw_manner
from echoavatar_lab.corpora.gesture.speakers import arousal, resting_of
from echoavatar_lab.corpora.sound import SoundTrack, Syllable


def test_idle_hands_hang_by_default_and_have_four_places():
    assert resting_of(Manner()) == "sides"
    assert {resting_of(draw_manner(seed)) for seed in range(60)} == {"sides", "clasped", "hips", "behind"}


def talking(rate: float, rng: np.random.Generator) -> SoundTrack:
    """Four seconds of so many bursts of noise a second."""
    starts = np.arange(0.1, 3.8, 1 / rate)
    time = np.arange(96_000) / 24_000
    loud = np.exp(-0.5 * ((time[:, None] - starts) / 0.06) ** 2).sum(1)
    noise = lfilter([1.0], [1.0, -0.97], rng.standard_normal(96_000))
    syllables = tuple(Syllable(t - 0.05, t + 0.05, t, 0.5, "la", "") for t in starts)
    return SoundTrack((0.05 * loud * noise).astype(np.float32), syllables=syllables, phrases=((0.0, 4.0),))


def test_a_faster_and_brighter_voice_is_more_excited_and_loudness_alone_is_not():
    rng = np.random.default_rng(0)
    track, phrase = talking(4.0, rng), (0.0, 4.0)
    usual = arousal(track, phrase)
    assert 0.7 < usual < 1.35
    assert arousal(replace(track, audio=0.1 * track.audio), phrase) == pytest.approx(usual, abs=0.02)
    assert arousal(replace(track, audio=np.append(np.diff(track.audio), 0)), phrase) > usual
    assert arousal(talking(5.0, rng), phrase) > usual
