"""Blocks of the band against one plain softmax."""

import pytest
import torch

from echoavatar.models.generator import attention
from echoavatar.models.generator.attention import banded_attention, masked_attention


def naive(q, k, v, lookback, valid=None):
    out = torch.zeros_like(q)
    for b in range(q.shape[0]):
        for t in range(q.shape[2]):
            seen = range(max(0, t - (lookback or t + 1) + 1), t + 1)
            keys = [s for s in seen if valid is None or valid[b, s] or s == t]
            weights = torch.softmax(q[b, :, t, None] @ k[b][:, keys].transpose(1, 2) / q.shape[3] ** 0.5, -1)
            out[b, :, t] = (weights @ v[b][:, keys])[:, 0]
    return out


def inputs(length):
    random = torch.Generator().manual_seed(length)
    return torch.randn(3, 2, 2, length, 4, generator=random, dtype=torch.double).unbind()


@pytest.mark.parametrize("lookback", [None, 1, 5, 40])
@pytest.mark.parametrize("length", [3, 23])
def test_the_band_is_exact_for_any_block_border(monkeypatch, lookback, length):
    monkeypatch.setattr(attention, "BLOCK", 7)
    q, k, v = inputs(length)
    torch.testing.assert_close(banded_attention(q, k, v, lookback), naive(q, k, v, lookback))


def test_positions_that_do_not_count_are_not_seen():
    q, k, v = inputs(12)
    valid = torch.ones(2, 12, dtype=torch.bool)
    valid[0, 2:6] = False
    torch.testing.assert_close(masked_attention(q, k, v, None, valid), naive(q, k, v, None, valid))
