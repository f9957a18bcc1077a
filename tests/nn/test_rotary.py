"""Rotary scores depend on distance alone, even after months."""

import math

import torch

from echoavatar.nn.rotary import phase_table, rotary, rotary_phases, rotary_table


def product(q, k, at_q, at_k):
    table = phase_table(rotary_phases(torch.tensor([at_q, at_k]), width=8)).float()
    return (rotary(q[None], table[:, :1]) * rotary(k[None], table[:, 1:])).sum()


def test_products_depend_on_the_distance_alone_also_after_a_month_of_streaming():
    """A month is 30 x 86,400 s x 240 ids per second = 6e8 ids, where float32 phases would be off by whole rotations."""
    q, k = torch.randn(2, 8, generator=torch.Generator().manual_seed(0))
    near, far = product(q, k, 70, 3), product(q, k, 600_000_070, 600_000_003)
    torch.testing.assert_close(near, far, atol=1e-5, rtol=0)
    assert abs(product(q, k, 71, 3) - near) > 1e-3


def test_the_first_pair_rotates_one_radian_per_position():
    phases = rotary_phases(torch.tensor([7]), width=8)
    assert math.isclose(float(phases[0, 0]), 7 - 2 * math.pi)
    x = torch.zeros(1, 8, dtype=torch.double)
    x[..., 0] = 1
    y = rotary(x, rotary_table(8, 8)[:, 7:])[0]
    assert math.isclose(float(y[0]), math.cos(7))
    assert math.isclose(float(y[4]), math.sin(7))
