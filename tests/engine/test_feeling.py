"""The feeling in a voice: heard in made-up voices, whatever their loudness, and shown on the face without a jump."""

import numpy as np
import pytest

from echoavatar.engine.feeling import STATISTICS, Feeling, statistics
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.expression import FEELINGS, Expression
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import CHUNK_FRAMES, CHUNK_SAMPLES, SAMPLE_RATE_HZ


def voice(pitch: float, range_: float, pace: float, tilt: float, seconds: float = 5.0) -> np.ndarray:
    """Syllables of a buzz: mean pitch (Hz), range (octaves), syllables a second, and its spectrum's dB an octave."""
    time = np.arange(int(seconds * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    hertz = pitch * 2 ** (range_ / 2 * np.sin(2 * np.pi * time * 0.7))
    phase, sound = 2 * np.pi * np.cumsum(hertz) / SAMPLE_RATE_HZ, np.zeros(len(time))
    for partial in range(1, 24):
        sound += 10 ** (-tilt * np.log2(partial) / 20) * np.sin(partial * phase)
    sound *= 0.05 + np.clip(np.sin(2 * np.pi * pace * time), 0, 1)
    return (0.2 * sound / np.abs(sound).max()).astype(np.float32)


def felt(sound: np.ndarray) -> np.ndarray:
    feeling = Feeling()
    pieces = sound[: len(sound) // CHUNK_SAMPLES * CHUNK_SAMPLES].reshape(-1, CHUNK_SAMPLES)
    return np.concatenate([feeling.hear(number, piece) for number, piece in enumerate(pieces)])


def test_a_high_wide_bright_voice_and_a_low_flat_dull_one_feel_otherwise() -> None:
    excited, dull = (felt(sound)[-1] for sound in (voice(330, 0.9, 4.5, 4), voice(110, 0.1, 2.0, 16)))
    assert excited[:2].sum() > dull[:2].sum() + 0.3  # happy or angry
    assert excited[2] < 0.05


def test_the_pitch_of_a_voice_is_measured() -> None:
    for pitch in (90.0, 180.0, 360.0):
        feeling = Feeling()
        for number, piece in enumerate(voice(pitch, 0, 3, 8)[: 8 * CHUNK_SAMPLES].reshape(-1, CHUNK_SAMPLES)):
            feeling.hear(number, piece)
        heard = statistics(feeling._memories[7].sums)
        assert len(heard) == STATISTICS
        assert 2 ** heard[STATISTICS - 6] == pytest.approx(pitch, rel=0.04)


def test_loudness_changes_nothing_and_silence_feels_nothing() -> None:
    """Once the first quarter of a second is forgotten, whose loudness nothing was known of."""
    sound = voice(330, 0.9, 4.5, 4, seconds=14)
    np.testing.assert_allclose(felt(sound)[-60:], felt(sound * 0.3)[-60:], atol=0.1)
    assert felt(np.zeros_like(sound)).max() == 0
    path = felt(np.concatenate([sound, np.zeros(8 * SAMPLE_RATE_HZ, np.float32)]))
    assert path[-1].max() < 0.05  # it fades


def test_it_follows_from_what_was_heard_alone() -> None:
    """A chunk made again is the same, and later sound changes nothing before it."""
    sound = voice(300, 0.8, 4, 5)
    other = sound.copy()
    other[3 * SAMPLE_RATE_HZ :] *= np.random.default_rng(0).normal(size=len(sound) - 3 * SAMPLE_RATE_HZ)
    before = 3 * SAMPLE_RATE_HZ // CHUNK_SAMPLES * CHUNK_FRAMES
    assert np.array_equal(felt(sound)[:before], felt(other)[:before])
    feeling, pieces = Feeling(), sound[: 18 * CHUNK_SAMPLES].reshape(-1, CHUNK_SAMPLES)
    first = [feeling.hear(number, piece) for number, piece in enumerate(pieces)]
    assert np.array_equal(first[9:], [feeling.hear(number, pieces[number]) for number in range(9, 18)])


@pytest.mark.parametrize(
    ("name", "rises", "falls"),
    [
        ("happy", "mouthSmileLeft", "browInnerUp"),
        ("angry", "browDownLeft", "browInnerUp"),
        ("sad", "browInnerUp", "mouthSmileLeft"),
    ],
)
def test_a_face_shows_it_smoothly_and_joy_does_not_look_worried(name: str, rises: str, falls: str) -> None:
    """Of a face whose inner brows are raised and whose lips smile a little by themselves."""
    face = np.zeros((CHUNK_FRAMES, 52), np.float32)
    face[:, ARKIT_NAMES.index("browInnerUp")] = 0.3
    face[:, ARKIT_NAMES.index("mouthSmileLeft")] = 0.1
    session, made = Expression(), []
    for number in range(6):
        shares = np.zeros((CHUNK_FRAMES, len(FEELINGS)))
        shares[:, FEELINGS.index(name)] = np.clip((np.arange(CHUNK_FRAMES) + number * CHUNK_FRAMES) / 20, 0, 1)
        motion = MotionChunk(np.zeros((CHUNK_FRAMES, 1, 4), np.float32), np.zeros((CHUNK_FRAMES, 3), np.float32), face)
        made.append(session.apply(number, motion, felt=shares).face)
    path = np.concatenate(made)
    up, down = (path[:, ARKIT_NAMES.index(curve)] for curve in (rises, falls))
    assert up[-1] > 0.55
    assert down[-1] < down[0] - 0.05
    assert np.abs(np.diff(path, axis=0)).max() < 0.1
