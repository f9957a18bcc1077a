"""Transformer blocks that attend to a whole clip, for reward models, which do not stream."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from ..nn import Mlp
from ..nn.attention import rotary, rotary_table


class FullBlock(nn.Module):
    """Pre-norm attention and MLP with residuals; every frame sees every other. Rotary positions."""

    def __init__(self, *, width: int, heads: int) -> None:
        super().__init__()
        if width % (2 * heads):
            raise ValueError(f"width ({width}) must be a multiple of twice the heads ({heads})")
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width, bias=False)
        self.proj = nn.Linear(width, width)
        self.mlp = Mlp(inputs=width, hidden=4 * width, outputs=width)

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """Process a whole clip."""
        split = (x.shape[0], x.shape[1], 3, self.heads, -1)
        q, k, v = self.qkv(self.norm1(x)).view(split).permute(2, 0, 3, 1, 4)
        table = rotary_table(x.shape[1], q.shape[-1]).to(q)
        mixed = F.scaled_dot_product_attention(rotary(q, table), rotary(k, table), v)
        x = x + self.proj(mixed.transpose(1, 2).flatten(2))
        y: Tensor = x + self.mlp(self.norm2(x))
        return y


def sinusoids(length: int, width: int) -> Float[Tensor, "t c"]:
    """Sinusoidal position encoding (paper, Audio-Motion Alignment Reward: PE)."""
    rates = 10_000.0 ** (-torch.arange(0, width, 2) / width)
    angles = torch.arange(length)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], -1).flatten(1)[:, :width]
