import numpy as np
import pytest

from echoavatar.models.audio import LevelControl

LEVEL = LevelControl()


def decibels(x: np.ndarray) -> float:
    return float(20 * np.log10(np.sqrt(np.square(x, dtype=float).mean()) + 1e-12))


def talk(rows: int, seconds: float, level_db: float, random: np.random.Generator) -> np.ndarray:
    """Noise in syllables: 150 ms of sound, 100 ms of pause 40 dB lower."""
    samples = round(seconds * 24_000) // 160 * 160
    noise = random.standard_normal((rows, samples), np.float32)
    x = noise * np.where(np.arange(samples) % 6_000 < 3_600, np.float32(1.0), np.float32(0.01))
    return x / np.sqrt(np.square(x).mean(1, keepdims=True)) * np.float32(10 ** (level_db / 20))


def noise(seconds: float, level_db: float, seed: int) -> np.ndarray:
    samples = np.random.default_rng(seed).standard_normal((1, round(seconds * 24_000)), np.float32)
    return samples * np.float32(10 ** (level_db / 20))


def tone() -> np.ndarray:
    """Four seconds of 300 Hz."""
    return np.sin(np.arange(96_000) / 24_000 * 2 * np.pi * 300)[None].astype(np.float32)


@pytest.mark.parametrize("size", [160, 320, 800, 6_400, 7_200])
def test_any_chunking_gives_the_same_bits(size):
    random = np.random.default_rng(1)
    loud, soft = talk(2, 0.6, -15, random), talk(2, 0.6, -45, random)
    x = np.concatenate([soft, loud, np.zeros((2, 9_600), np.float32), soft], 1)
    x = x[:, : x.shape[1] // size * size]
    state, active = LEVEL.init_state(2), np.ones(2, np.bool_)
    parts = [LEVEL.step(part, state, active) for part in np.split(x, x.shape[1] // size, 1)]
    np.testing.assert_array_equal(np.concatenate(parts, 1), LEVEL(x))


def test_the_sound_that_is_given_stays_as_it_is_and_may_be_read_only():
    x = noise(0.4, -40, 1)
    before = x.copy()
    x.flags.writeable = False
    assert decibels(LEVEL.step(x, LEVEL.init_state(1), np.ones(1, np.bool_))) > -35
    np.testing.assert_array_equal(x, before)


@pytest.mark.parametrize("level_db", [-50, -40, -23, -10])
def test_speech_of_any_level_comes_out_near_the_target(level_db):
    x = talk(1, 8, level_db, np.random.default_rng(2))
    assert -25 < decibels(LEVEL(x)) < -19
    assert -27 < decibels(LEVEL(x)[:, : 24_000 // 2]) < -15, "half a second is enough to find it"


def test_silence_is_not_turned_into_noise():
    assert not LEVEL(np.zeros((1, 24_000), np.float32)).any()
    for level_db in (-75, -55, -45):
        assert decibels(LEVEL(noise(10, level_db, 3))) < level_db - 10


def test_noise_between_quiet_sentences_is_held_down():
    """Speech at -50 dBFS is lifted by 27 dB, the noise (-80) of the pauses by 9 once the gate has closed."""
    out = LEVEL(np.concatenate([talk(1, 3, -50, np.random.default_rng(4)), noise(2, -80, 4)], 1))
    assert decibels(out[:, -24_000:]) < -65


def test_full_scale_clipping_stays_in_range():
    x = np.clip(20 * noise(2, 0, 5), -1, 1)
    assert np.abs(LEVEL(x)).max() < 1
    burst = np.concatenate([talk(1, 3, -50, np.random.default_rng(6)), x], 1)
    assert np.abs(LEVEL(burst)).max() < 1


def test_dynamics_of_music_survive():
    """A passage 10 dB softer for 4 s comes out at least 7 dB softer."""
    out = LEVEL(np.concatenate([noise(4, -20, 7), noise(4, -30, 7)], 1))
    assert decibels(out[:, :96_000]) - decibels(out[:, 96_000:]) > 7


def test_gain_never_jumps():
    """A constant input shows the gain itself: no step between samples over 1 % of its range."""
    x = np.full((1, 48_000), 0.002, np.float32)
    x[:, 24_000:] = 0.2
    gain = LEVEL(x)[0] / x[0]
    assert np.abs(np.diff(gain)).max() < 0.01 * gain.max()


def test_any_length_is_served_offline_and_whole_blocks_live():
    assert LEVEL(np.zeros((1, 1_001), np.float32)).shape == (1, 1_001)
    assert LEVEL(np.zeros((1, 0), np.float32)).shape == (1, 0)
    with pytest.raises(ValueError, match="multiple of 160 samples, got 100"):
        LEVEL.step(np.zeros((1, 100), np.float32), LEVEL.init_state(1), np.ones(1, np.bool_))


def test_a_soft_passage_is_loud_again_after_twenty_seconds():
    """15 dB softer than the second before it."""
    out = LEVEL(np.concatenate([noise(1, -20, 8), noise(20, -35, 9)], 1))
    assert decibels(out[:, 24_000:48_000]) < -33
    assert -24 < decibels(out[:, -24_000:]) < -19


def test_a_fan_that_is_switched_on_is_sound_for_ten_seconds_and_noise_from_then_on():
    out = LEVEL(np.concatenate([noise(1, -80, 10), noise(14, -50, 11)], 1))
    assert -24 < decibels(out[:, 7 * 24_000 : 8 * 24_000]) < -18
    assert decibels(out[:, 12 * 24_000 :]) < -35


def test_what_can_hardly_be_heard_is_not_lifted_and_what_surely_is_sound_is():
    """Whispers at -66 dBFS, a steady tone at -36, and speech at -45 over noise of -65."""
    assert decibels(LEVEL(talk(1, 4, -66, np.random.default_rng(12)))) < -64
    assert -22 < decibels(LEVEL(tone() * np.float32(10 ** (-36 / 20) * 2**0.5))[:, -24_000:]) < -20
    mixed = talk(1, 6, -45, np.random.default_rng(13)) + noise(6, -65, 14)
    assert -24 < decibels(LEVEL(mixed)[:, 24_000:]) < -19


def test_the_gate_closes_smoothly_after_a_quarter_of_a_second():
    """The gain in a pause after speech: held for 0.25 s, 4 dB lower 0.1 s later, 18 dB lower at last."""
    words = talk(1, 3, -30, np.random.default_rng(15))[:, : 72_000 - 2_400]
    out = LEVEL(np.concatenate([words, np.full((1, 48_000), 1e-3, np.float32)], 1))[0, words.shape[1] :]
    held, soon, closed = (20 * np.log10(out[round(when * 24_000)] / out[0]) for when in (0.2, 0.35, 1.0))
    assert abs(held) < 0.1
    assert -7 < soon < -2
    assert -20 < closed < -16


def test_peaks_are_bent_softly():
    """A click on a soft tone: at 0.6 it stays, at 0.9 it is bent to 0.82."""
    soft = 0.126 * tone()
    for peak, heard in ((0.6, 0.6), (0.9, 0.82)):
        soft[0, 80_000] = peak
        assert LEVEL(soft)[0, 80_000] == pytest.approx(heard, abs=0.01)
