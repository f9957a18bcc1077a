"""Rotary positions with double-precision angles, exact after hours of streaming."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor


def rotary_angles(positions: Int[Tensor, "b t"], *, width: int, theta: float) -> Float[Tensor, "b t h"]:
    """Angles (b, t, width / 2) in radians within one turn, double precision.

    A float32 angle at position 1e7 is off by half a radian; so the turn is removed in float64 first.
    """
    exponent = torch.arange(0, width, 2, dtype=torch.float64, device=positions.device) / width
    return (positions.double()[..., None] * theta**-exponent) % (2 * math.pi)


def rotate(x: Float[Tensor, "b h t d"], angles: Float[Tensor, "#b t half"]) -> Float[Tensor, "b h t d"]:
    """Turn the pairs (i, i + d / 2) of each head, the order of Qwen2's weights."""
    cos, sin = (f(angles).to(torch.float32)[:, None] for f in (torch.cos, torch.sin))
    if x.dtype == torch.float64:
        cos, sin = torch.cos(angles)[:, None], torch.sin(angles)[:, None]
    first, second = x.chunk(2, dim=-1)
    return torch.cat([first * cos - second * sin, second * cos + first * sin], dim=-1)
