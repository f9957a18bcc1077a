"""Uniform noise is keyed, uniform and independent."""

import numpy as np
import torch

from echoavatar.models.noise import mix, uniform_noise
from echoavatar_lab.models.generator import sampling


def noise(seed: int, start: int, count: int = 4, codes: int = 512) -> np.ndarray:
    return uniform_noise(np.array([seed]), np.array([start]), count=count, codes=codes)[0]


def test_mix_is_splitmix64():
    """The published first output for seed 0 is 0xE220A8397B1DCDAF: the finaliser of one golden step."""
    assert mix(np.array([0x9E3779B97F4A7C15], np.uint64)) == 0xE220A8397B1DCDAF


def test_noise_depends_on_seed_and_absolute_position_alone():
    assert np.array_equal(noise(5, 0, count=8)[3:], noise(5, 3, count=5))
    assert not np.array_equal(noise(5, 0), noise(6, 0))
    both = uniform_noise(np.array([9, 5]), np.array([77, 3]), count=5, codes=512)
    assert np.array_equal(both[1], noise(5, 3, count=5))


def test_it_is_the_noise_of_the_generator():
    seeds, start = np.array([0, -7, 2**62]), np.array([0, -3, 10**12])
    theirs = sampling.uniform_noise(torch.from_numpy(seeds), torch.from_numpy(start), count=3, codes=4)
    np.testing.assert_array_equal(uniform_noise(seeds, start, count=3, codes=4), theirs.numpy())


def test_noise_is_uniform_and_seeds_are_unrelated():
    """100,000 numbers: mean within 4 sigma of 1/2, tenths of 10,000, correlation of 0."""
    one, two = (noise(seed, 0, count=200, codes=500).ravel() for seed in (1, 2))
    assert abs(one.mean() - 0.5) < 4 * 0.2887 / 1e5**0.5
    assert 0 < one.min() < one.max() < 1
    tenths, _ = np.histogram(one, 10, (0, 1))
    assert (np.abs(tenths - 10_000) < 4 * (10_000 * 0.9) ** 0.5).all()
    assert abs(np.corrcoef(one, two)[0, 1]) < 4 / 1e5**0.5
    assert abs(np.corrcoef(one[1:], one[:-1])[0, 1]) < 4 / 1e5**0.5
