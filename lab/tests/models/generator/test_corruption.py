"""Corruption does what the appendix says, and nothing else."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from echoavatar_lab.models.generator.corruption import corrupt_hierarchically, corrupt_uniformly

OUTSIDE = 1_000_000  # codes that noise never draws, so that every replacement shows


def corrupted(rate, *, steps=20, rows=2, layers=4, seed=0):
    codes = torch.full((rows, steps, 3, layers), OUTSIDE)
    random = torch.Generator().manual_seed(seed)
    return corrupt_hierarchically(codes, rate, codebook=512, generator=random) != OUTSIDE


@given(st.integers(0, 10), st.integers(1, 30), st.integers(0, 99))
def test_exactly_floor_of_rate_times_steps_are_touched_in_every_part(tenths, steps, seed):
    """|S| = floor(rho T); a touched step always loses its last layer."""
    touched = corrupted(tenths / 10, steps=steps, seed=seed)
    assert torch.equal(touched[..., -1].sum(1), torch.full((2, 3), tenths * steps // 10))


def test_all_layers_behind_the_first_corrupted_one_are_corrupted():
    touched = corrupted(0.7, steps=100).int()
    assert bool((touched.diff(dim=-1) >= 0).all())


def test_the_first_corrupted_layer_is_uniform():
    """With rate 1 and Q = 4 layer q is touched with probability (q + 1) / 4; 6,000 draws, 4 sigma = 0.026."""
    share = corrupted(1.0, steps=1000).float().mean(dim=(0, 1, 2))
    torch.testing.assert_close(share, torch.tensor([0.25, 0.5, 0.75, 1.0]), atol=0.026, rtol=0)


def test_parts_are_corrupted_independently():
    touched = corrupted(0.5, steps=200)[..., -1]
    assert not torch.equal(touched[:, :, 0], touched[:, :, 1])


def test_each_row_may_have_its_own_rate():
    touched = corrupted(torch.tensor([0.0, 1.0]))
    assert not touched[0].any()
    assert bool(touched[1, ..., -1].all())


def test_uniform_corruption_hits_every_layer_at_its_rate_with_every_code():
    codes = torch.full((4, 500, 3, 4), OUTSIDE)
    out = corrupt_uniformly(codes, 0.3, codebook=8, generator=torch.Generator().manual_seed(1))
    share = (out != OUTSIDE).float().mean(dim=(0, 1, 2))
    torch.testing.assert_close(share, torch.full((4,), 0.3), atol=0.025, rtol=0)
    assert set(out.unique().tolist()) == {*range(8), OUTSIDE}


def test_the_same_seed_corrupts_the_same_codes():
    codes = torch.arange(240).view(1, 20, 3, 4)
    one, two = (
        corrupt_hierarchically(codes, 0.5, codebook=9, generator=torch.Generator().manual_seed(5)) for _ in range(2)
    )
    assert torch.equal(one, two)
