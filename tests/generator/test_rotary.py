"""Rotary turns depend on distance alone, even after months."""

import math

import torch

from echoavatar.generator.rotary import rotary_angles, rotate


def product(q, k, at_q, at_k):
    angles = rotary_angles(torch.tensor([[at_q, at_k]]), width=8, theta=1e4)
    return (rotate(q[None, None, None], angles[:, :1]) * rotate(k[None, None, None], angles[:, 1:])).sum()


def test_products_depend_on_the_distance_alone_also_after_a_month_of_streaming():
    """A month is 30 x 86,400 s x 240 ids per second = 6e8 ids, where float32 angles would be off by whole turns."""
    q, k = torch.randn(2, 8, generator=torch.Generator().manual_seed(0))
    near, far = product(q, k, 70, 3), product(q, k, 600_000_070, 600_000_003)
    torch.testing.assert_close(near, far, atol=1e-5, rtol=0)
    assert abs(product(q, k, 71, 3) - near) > 1e-3


def test_the_first_pair_turns_one_radian_per_position():
    angles = rotary_angles(torch.tensor([[7]]), width=8, theta=1e4)
    assert math.isclose(float(angles[0, 0, 0]), 7 - 2 * math.pi)
    x = torch.zeros(1, 1, 1, 8, dtype=torch.double)
    x[..., 0] = 1
    y = rotate(x, angles)[0, 0, 0]
    assert math.isclose(float(y[0]), math.cos(7))
    assert math.isclose(float(y[4]), math.sin(7))
