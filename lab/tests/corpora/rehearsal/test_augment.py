import numpy as np
import pytest

from echoavatar_lab.corpora.rehearsal.augment import (
    add_background,
    background,
    equalise,
    fill_band,
    loudness,
    low_pass,
    place_in_room,
    saturate,
    set_loudness,
    treat,
)


def click(at: int = 12000) -> np.ndarray:
    audio = np.zeros(24000, np.float32)
    audio[at] = 0.5
    return audio


def band_db(audio: np.ndarray, low: float, high: float) -> float:
    power = np.abs(np.fft.rfft(audio)) ** 2
    hertz = np.fft.rfftfreq(len(audio), 1 / 24000)
    return float(10 * np.log10(power[(hertz >= low) & (hertz < high)].mean() + 1e-12))


@pytest.mark.parametrize("target", [-40.0, -23.0, -16.0])
def test_loudness_reaches_its_target(target):
    noise = np.random.default_rng(0).standard_normal(72000).astype(np.float32) * 0.02
    out = set_loudness(noise, target)
    assert loudness(out) == pytest.approx(target, abs=1.0)
    assert np.abs(out).max() <= 0.89 + 1e-6


def test_silence_stays_silent():
    assert (set_loudness(np.zeros(24000, np.float32), -20) == 0).all()


def test_a_sine_at_full_scale_is_near_minus_three():
    tone = np.sin(2 * np.pi * 1000 * np.arange(48000) / 24000).astype(np.float32)
    assert loudness(tone) == pytest.approx(-3.7, abs=0.3)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_sounds_before_its_time(seed):
    rng = np.random.default_rng(seed)
    for out in (equalise(click(), rng), place_in_room(click(), rng), treat(click(), rng)):
        assert out.shape == (24000,)
        assert np.abs(out[:11999]).max() < 1e-6
        assert np.argmax(np.abs(out)) - 12000 < 12


def test_the_missing_top_of_speech_is_filled():
    rng = np.random.default_rng(0)
    speech = low_pass(rng.standard_normal(48000).astype(np.float32) * 0.1, 7600)
    speech = low_pass(speech, 7600)
    filled = fill_band(speech, rng)
    assert band_db(filled, 9500, 11000) > band_db(speech, 9500, 11000) + 4
    assert abs(band_db(filled, 500, 4000) - band_db(speech, 500, 4000)) < 0.2


@pytest.mark.parametrize("seed", range(8))
def test_backgrounds_have_unit_level(seed):
    noise = background(np.random.default_rng(seed), 48000)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(1.0, rel=0.01)


def test_background_is_as_far_below_as_asked():
    tone = 0.2 * np.sin(2 * np.pi * 500 * np.arange(48000) / 24000).astype(np.float32)
    noise = add_background(tone, np.random.default_rng(0), 30.0) - tone
    assert 20 * np.log10(np.std(tone) / np.std(noise)) == pytest.approx(30, abs=1)


def test_saturation_leaves_small_signals_alone():
    small = np.full(10, 1e-3, np.float32)
    assert np.allclose(saturate(small, 2.0), small, rtol=1e-4)
    assert saturate(np.ones(1, np.float32), 2.0)[0] < 0.5
