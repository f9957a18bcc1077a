"""Rotary positions: pairs of channels rotate by phases that grow with the position.

Phases are computed in double precision: a float32 phase at position 1e7 would be off by half a radian.
"""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

ROPE_BASE = 10_000.0


def rotary_phases(positions: Int[Tensor, "*b t"], *, width: int, base: float = ROPE_BASE) -> Float[Tensor, "*b t half"]:
    """Phase of pair i, position * base^(-2i / width), in radians within one rotation, double precision."""
    exponent = torch.arange(0, width, 2, dtype=torch.float64, device=positions.device) / width
    return (positions.double()[..., None] * base**-exponent) % (2 * math.pi)


def phase_table(phases: Float[Tensor, "*b t half"]) -> Float[Tensor, "2 *b t d"]:
    """Cosines and signed sines for `rotary`."""
    cos, sin = phases.cos(), phases.sin()
    return torch.stack([torch.cat([cos, cos], -1), torch.cat([-sin, sin], -1)])


def rotary_table(length: int, width: int) -> Float[Tensor, "2 t d"]:
    """The table of positions 0 to `length` - 1, double precision."""
    return phase_table(rotary_phases(torch.arange(length), width=width))


def rotary(x: Float[Tensor, "*b t d"], table: Float[Tensor, "2 *#b t d"]) -> Float[Tensor, "*b t d"]:
    """Rotate the pairs of channels (i, i + d / 2) by the phases of their position."""
    return torch.addcmul(x * table[0], x.roll(x.shape[-1] // 2, -1), table[1])
