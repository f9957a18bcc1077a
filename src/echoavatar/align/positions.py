"""Sinusoidal position encoding of the reward models."""

import torch
from jaxtyping import Float
from torch import Tensor


def sinusoids(length: int, width: int) -> Float[Tensor, "t c"]:
    """Sinusoidal position encoding (paper, Audio-Motion Alignment Reward: PE)."""
    rates = 10_000.0 ** (-torch.arange(0, width, 2) / width)
    angles = torch.arange(length)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], -1).flatten(1)[:, :width]
