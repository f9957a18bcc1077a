"""The compiled pieces against torch's own."""

import numpy as np
import torch
import torch.nn.functional as F
from numpy.testing import assert_allclose

from echoavatar.nn.kernel_math import attend, exponential, gelu, silu, softmax

X = np.linspace(-30, 30, 2_001).astype(np.float32)


def test_exponential_and_gates_are_torchs():
    x = torch.from_numpy(X)
    assert_allclose([exponential(v) for v in X], np.exp(X.astype(np.float64)), rtol=5e-6)
    assert_allclose([silu(v) for v in X], F.silu(x), atol=2e-6)
    assert_allclose([gelu(v) for v in X], F.gelu(x), atol=2e-6)


def test_exponential_neither_overflows_nor_vanishes_beyond_its_range():
    assert 0 < exponential(np.float32(-np.inf)) < 1e-37
    assert 1e37 < exponential(np.float32(1e9)) < np.inf


def test_softmax_hides_what_is_minus_infinity():
    x = np.random.default_rng(0).normal(size=57).astype(np.float32) * 8
    x[[0, 20]] = -np.inf
    wanted = torch.softmax(torch.from_numpy(x), 0)
    softmax(x)
    assert_allclose(x, wanted, atol=1e-6)
    assert x[0] == x[20] == 0  # and not a denormal number, which would make every product with it slow


def test_attention_in_a_corner_of_larger_arrays():
    """Head width 6 is no multiple of the four channels that one pass takes."""
    random = np.random.default_rng(1)
    query, store = random.normal(size=6).astype(np.float32), random.normal(size=(20, 30)).astype(np.float32)
    bias = random.normal(size=11).astype(np.float32)
    mixed = np.empty(6, np.float32)
    attend(query, store, 2, store, 10, 7, bias, np.empty(11, np.float32), mixed)
    keys, values = (torch.from_numpy(store[row : row + 6, 7:18]) for row in (2, 10))
    weights = torch.softmax(torch.from_numpy(query) @ keys + torch.from_numpy(bias), 0)
    assert_allclose(mixed, values @ weights, atol=2e-6)
