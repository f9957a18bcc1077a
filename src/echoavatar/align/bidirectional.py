"""Transformer blocks that attend to a whole clip, for reward models, which do not stream."""

import torch
from jaxtyping import Float
from torch import Tensor

from ..nn import FullBlock

__all__ = ["FullBlock", "sinusoids"]


def sinusoids(length: int, width: int) -> Float[Tensor, "t c"]:
    """Sinusoidal position encoding (paper, Audio-Motion Alignment Reward: PE)."""
    rates = 10_000.0 ** (-torch.arange(0, width, 2) / width)
    angles = torch.arange(length)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], -1).flatten(1)[:, :width]
