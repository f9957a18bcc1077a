"""The feeling in a voice: heard in made-up voices that change, whatever the loudness and the chunks."""

import numpy as np
import pytest

from echoavatar.motion.feeling import FEELINGS, LAYER, Feeling, statistics
from echoavatar.timing import CHUNK_SAMPLES, FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_MOTION_TOKEN


def voice(pitch: float, range_: float, pace: float, tilt: float, seconds: float = 8.0) -> np.ndarray:
    """Syllables of a buzz: mean pitch (Hz), range (octaves), syllables a second, and its spectrum's dB an octave."""
    time = np.arange(int(seconds * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    hertz = pitch * 2 ** (range_ / 2 * np.sin(2 * np.pi * time * 0.7))
    phase, sound = 2 * np.pi * np.cumsum(hertz) / SAMPLE_RATE_HZ, np.zeros(len(time))
    for partial in range(1, 24):
        sound += 10 ** (-tilt * np.log2(partial) / 20) * np.sin(partial * phase)
    sound *= 0.05 + np.clip(np.sin(2 * np.pi * pace * time), 0, 1)
    return (0.2 * sound / np.abs(sound).max()).astype(np.float32)


PLAIN = voice(160, 0.3, 3.5, 8)
EXCITED, DULL = (np.concatenate([PLAIN, other]) for other in (voice(300, 1.2, 4.5, 8), voice(100, 0.02, 2.0, 8)))


def felt(sound: np.ndarray, step: int = CHUNK_SAMPLES) -> np.ndarray:
    feeling = Feeling()
    pieces = sound[: len(sound) // step * step].reshape(-1, step)
    return np.concatenate([feeling.hear(number, piece) for number, piece in enumerate(pieces)])


def test_a_voice_feels_what_it_differs_in_from_itself() -> None:
    assert felt(PLAIN)[4 * FRAME_RATE_HZ :].max() < 0.05  # once it is known
    excited, dull = (felt(sound)[8 * FRAME_RATE_HZ :].mean(0) for sound in (EXCITED, DULL))
    assert excited[FEELINGS.index("happy")] > 0.2
    assert dull[FEELINGS.index("sad")] > 0.15
    assert excited[2] == dull[:2].max() == 0


@pytest.mark.parametrize("pitch", [90.0, 180.0, 360.0])
def test_the_pitch_of_a_voice_is_measured(pitch: float) -> None:
    feeling = Feeling()
    for number, piece in enumerate(voice(pitch, 0, 3, 8)[: 8 * CHUNK_SAMPLES].reshape(-1, CHUNK_SAMPLES)):
        feeling.hear(number, piece)
    heard = dict(zip(LAYER, statistics(feeling.memories[7].sums), strict=True))
    assert 2 ** (heard["pitch"] / 12) == pytest.approx(pitch, rel=0.04)
    assert heard["clarity"] > 0.9


def test_loudness_changes_nothing_and_silence_and_hiss_feel_nothing() -> None:
    np.testing.assert_allclose(felt(EXCITED), felt(EXCITED * 0.3), atol=0.02)
    hiss = 0.1 * np.random.default_rng(0).normal(size=4 * SAMPLE_RATE_HZ).astype(np.float32)
    assert felt(np.zeros_like(EXCITED)).max() == felt(hiss).max() == 0
    assert felt(np.concatenate([EXCITED, np.zeros(8 * SAMPLE_RATE_HZ, np.float32)]))[-1].max() < 0.05  # it fades


def test_it_follows_from_what_was_heard_alone_whatever_the_chunks() -> None:
    """A chunk made again is the same, and later sound changes nothing before it."""
    path, at = felt(EXCITED), 12 * SAMPLE_RATE_HZ
    assert np.array_equal(felt(EXCITED, SAMPLES_PER_MOTION_TOKEN)[: len(path)], path)
    other = np.concatenate([EXCITED[:at], DULL[at:]])
    assert np.array_equal(felt(other)[: 11 * FRAME_RATE_HZ], path[: 11 * FRAME_RATE_HZ])
    feeling, pieces = Feeling(), EXCITED[: 50 * CHUNK_SAMPLES].reshape(-1, CHUNK_SAMPLES)
    first = [feeling.hear(number, piece) for number, piece in enumerate(pieces)]
    assert np.max(first) > 0
    assert np.array_equal(first[40:], [feeling.hear(number, pieces[number]) for number in range(40, 50)])
    assert path.shape[1] == len(FEELINGS)
