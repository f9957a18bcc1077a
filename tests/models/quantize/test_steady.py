"""The steadiest codes against every way there is, and against what the price promises."""

import itertools

import pytest
import torch

from echoavatar.models.quantize.steady import steadiest


def cost(distances, price, path):
    changes = sum(a != b for a, b in itertools.pairwise(path))
    return sum(float(distances[t, k]) for t, k in enumerate(path)) + price * changes


@pytest.mark.parametrize("seed", range(6))
def test_no_way_through_is_cheaper(seed):
    """All 3^6 ways through six steps of three codes."""
    distances = torch.rand(6, 3, generator=torch.Generator().manual_seed(seed))
    for price in (0.05, 0.3, 1.0):
        best = min(cost(distances, price, way) for way in itertools.product(range(3), repeat=6))
        assert cost(distances, price, steadiest(distances, price).tolist()) == pytest.approx(best)


def test_no_price_takes_the_nearest_and_a_high_one_a_single_code():
    distances = torch.rand(40, 8, generator=torch.Generator().manual_seed(0))
    assert torch.equal(steadiest(distances, 0.0), distances.argmin(1))
    single = steadiest(distances, 1e6)
    assert single.unique().tolist() == [int(distances.sum(0).argmin())]


def test_one_step_is_the_nearest():
    assert steadiest(torch.tensor([[3.0, 1.0, 2.0]]), 5.0).tolist() == [1]
