import numpy as np
import pytest
import soxr
from hypothesis import given, settings
from hypothesis import strategies as st

from echoavatar.errors import AudioError
from echoavatar.models.audio import StreamResampler, as_mono


def stream(samples: np.ndarray, rate: int, size: int) -> np.ndarray:
    resampler = StreamResampler(rate)
    parts = [resampler.push(samples[i : i + size]) for i in range(0, len(samples), size)]
    return np.concatenate([*parts, resampler.flush()])


@settings(max_examples=30, deadline=None)
@given(
    rate=st.sampled_from([8_000, 11_025, 16_000, 22_050, 24_000, 44_100, 48_000, 96_000]),
    samples=st.integers(0, 5_000),
    size=st.integers(1, 1_500),
)
def test_length_is_exact_after_flush(rate, samples, size):
    out = stream(np.zeros(samples, np.float32), rate, max(size, 50))
    assert abs(len(out) - samples * 24_000 / rate) <= 0.5


@pytest.mark.parametrize("rate", [8_000, 44_100, 96_000])
def test_any_chunking_equals_one_piece(rate):
    audio = np.random.default_rng(0).standard_normal(rate // 2).astype(np.float32) * 0.1
    whole = stream(audio, rate, len(audio))
    for size in (100, 777, 4_096):
        np.testing.assert_allclose(stream(audio, rate, size), whole, atol=2e-6)


@pytest.mark.parametrize("rate", [8_000, 44_100, 48_000])
def test_a_tone_keeps_its_pitch_phase_and_size(rate):
    """Outside witness: the 440 Hz sine itself, away from the ends."""
    tone = np.sin(2 * np.pi * 440 * np.arange(rate) / rate).astype(np.float32)
    wanted = np.sin(2 * np.pi * 440 * np.arange(24_000) / 24_000)
    np.testing.assert_allclose(stream(tone, rate, 1_000)[2_000:-2_000], wanted[2_000:-2_000], atol=2e-3)


def test_own_rate_passes_unchanged():
    audio = np.random.default_rng(0).standard_normal(1_000).astype(np.float32)
    assert np.array_equal(stream(audio, 24_000, 300), audio)


def test_integers_and_channels_are_scaled_and_averaged():
    assert as_mono(np.array([-32_768, 16_384], np.int16)).tolist() == [-1.0, 0.5]
    assert as_mono(np.array([0, 128, 192], np.uint8)).tolist() == [-1.0, 0.0, 0.5]
    assert as_mono(np.array([[-(2**31)], [2**30]], np.int32)).tolist() == [-1.0, 0.5]
    assert as_mono(np.array([[0.1, 0.3, 0.5, 0, 0, 0]], np.float64)).tolist() == pytest.approx([0.15])


def test_six_channels_at_96_khz_equal_their_mean():
    audio = np.random.default_rng(0).standard_normal((9_600, 6)).astype(np.float32) * 0.1
    wanted = soxr.resample(audio.mean(1), 96_000, 24_000)
    np.testing.assert_allclose(stream(audio, 96_000, 1_000), wanted, atol=1e-4)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_numbers_are_named_by_their_place(value):
    """Sample 8,000 + 160 of a stream at 16 kHz is 0.510 s."""
    resampler, audio = StreamResampler(16_000), np.zeros((8_000, 2), np.float32)
    resampler.push(audio)
    audio[160, 1] = value
    with pytest.raises(AudioError, match=r"audio sample 8160 \(0.510 s\) is (nan|inf|-inf); replace"):
        resampler.push(audio)


def test_integers_disguised_as_floats_are_refused():
    with pytest.raises(AudioError, match="is 12000; floating-point audio lies in -1..1"):
        as_mono(np.array([0, 12_000.0]))


@pytest.mark.parametrize(
    ("samples", "reason"),
    [
        (np.zeros((2, 3, 4)), "audio of shape"),
        (np.zeros((2, 24_000)), "transpose it first"),
        (np.zeros(4, complex), "samples of type complex128"),
        (np.array(["a"]), "samples of type"),
    ],
)
def test_wrong_shapes_and_types_are_refused(samples, reason):
    with pytest.raises(AudioError, match=reason):
        as_mono(samples)


def test_wrong_rates_and_ended_streams_are_refused():
    with pytest.raises(AudioError, match="sample rate of 0 Hz"):
        StreamResampler(0)
    resampler = StreamResampler(8_000)
    resampler.flush()
    assert len(resampler.flush()) == 0
    with pytest.raises(AudioError, match="has ended"):
        resampler.push(np.zeros(10))
