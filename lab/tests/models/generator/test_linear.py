"""Frozen maps against torch's own, each within what its number format allows."""

import pytest
import torch
import torch.nn.functional as F

from echoavatar_lab.models.generator.linear import frozen_linear


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 1e-6), ("bfloat16", 0.02), ("int8", 0.02)])
@pytest.mark.parametrize("rows", [1, 40])
def test_a_frozen_map_is_the_map(precision, tolerance, rows):
    random = torch.Generator().manual_seed(0)
    weight, bias = torch.randn(48, 64, generator=random) / 8, torch.randn(48, generator=random)
    x = torch.randn(rows, 64, generator=random)
    linear = frozen_linear(precision, weight, bias)
    y, expected = linear(x.to(linear.dtype)).float(), F.linear(x, weight, bias)
    assert (y - expected).square().mean().sqrt() < tolerance * expected.square().mean().sqrt()


def test_int8_rows_do_not_depend_on_their_neighbours():
    linear = frozen_linear("int8", torch.randn(48, 64, generator=torch.Generator().manual_seed(0)))
    x = torch.randn(2, 64, generator=torch.Generator().manual_seed(1))
    loud = torch.stack([x[0], 100 * x[1]])
    assert torch.equal(linear(x)[0], linear(loud)[0])
