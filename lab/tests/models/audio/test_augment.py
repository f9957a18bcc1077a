import numpy as np
import pytest

from echoavatar_lab.models.audio.augment import augment, source_samples


def piece(seed: int, samples: int = 24_000) -> tuple[np.random.Generator, np.ndarray, float]:
    rng = np.random.default_rng(seed)
    factor, needed = source_samples(rng, samples)
    return rng, rng.standard_normal(needed).astype(np.float32) * 0.1, factor


@pytest.mark.parametrize("seed", range(30))
def test_pairs_are_finite_whole_and_in_range(seed):
    rng, source, factor = piece(seed)
    pair = augment(rng, source, factor, 24_000)
    for sound in pair:
        assert sound.shape == (24_000,)
        assert sound.dtype == np.float32
        assert np.isfinite(sound).all()
        assert np.abs(sound).max() <= 1


def test_same_seed_same_pair_other_seed_other_pair():
    first, again, other = (augment(*piece(seed)[:2], piece(seed)[2], 24_000) for seed in (1, 1, 2))
    assert np.array_equal(first.heard, again.heard)
    assert not np.array_equal(first.heard, other.heard)


def test_the_target_is_never_noisier_than_what_is_heard():
    """Over many draws some pairs are equal, some differ, and the target follows the source's timing (no delay)."""
    differs, lags = 0, []
    for seed in range(20):
        rng, source, factor = piece(seed, 8_000)
        pair = augment(rng, source, factor, 8_000)
        differs += not np.array_equal(pair.heard, pair.target)
        spectrum = np.fft.rfft(pair.heard, 16_384) * np.conj(np.fft.rfft(pair.target, 16_384))
        lags.append(int(np.argmax(np.abs(np.fft.irfft(spectrum)[:200]))))
    assert 5 < differs <= 20
    assert max(lags) <= 2


def test_silence_stays_nearly_silent():
    rng, source, factor = piece(3)
    pair = augment(rng, np.zeros_like(source), factor, 24_000)
    assert np.abs(pair.heard).max() < 0.02
    assert np.abs(pair.target).max() < 0.02
