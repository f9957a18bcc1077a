"""The release's whole-body autoencoder: its tokenizer's layers without quantiser, attending in both directions.

The published code contains it with a path to weights that were not published; the paper's FID on ZeroEGGS and Motorica
was probably computed on its latents. State-dict names are those of the release, so its weights would load.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar.nn import CausalBlock, Mlp

LEVELS = 3
LOOKBACK = 15
HEADS = 8


class AttentionAutoencoder(nn.Module):
    """Encodes normalised features of the whole body (531 for the release's rig) into one latent for four frames."""

    def __init__(self, *, features: int, width: int = 512) -> None:
        super().__init__()
        down = range(LEVELS)
        self.input_liner = nn.Linear(features, width)
        self.encoder = nn.ModuleList(_block(width, level) for level in down)
        self.down_sample = nn.ModuleList(Mlp(inputs=2 * width, hidden=4 * width, outputs=width) for _ in down[1:])
        self.decoder = nn.ModuleList(_block(width, level) for level in reversed(down))
        self.up_sample = nn.ModuleList(Mlp(inputs=width, hidden=4 * width, outputs=2 * width) for _ in down[1:])
        self.output_liner = nn.Linear(width, features)

    def encode(self, features: Float[Tensor, "b t c"]) -> Float[Tensor, "b n d"]:
        """Latents of features; the number of frames must be a multiple of four."""
        h: Tensor = self.input_liner(features)
        for level, block in enumerate(self.encoder):
            h = _see_both_ways(block, h)
            if level + 1 < LEVELS:
                pairs = h.reshape(h.shape[0], h.shape[1] // 2, -1)
                h = (h[:, 0::2] + h[:, 1::2]) / 2 + self.down_sample[level](pairs)
        return h

    def decode(self, latents: Float[Tensor, "b n d"]) -> Float[Tensor, "b t c"]:
        """Features of latents."""
        z = latents
        for level, block in enumerate(self.decoder):
            z = _see_both_ways(block, z)
            if level + 1 < LEVELS:
                z = z.repeat_interleave(2, 1) + self.up_sample[level](z).reshape(z.shape[0], -1, z.shape[2])
        y: Tensor = self.output_liner(z)
        return y

    def forward(self, features: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """Encode and decode."""
        return self.decode(self.encode(features))


def within(frames: int, reach: int) -> Bool[Tensor, "t t"]:
    """Attention mask: frames see each other if they are at most `reach` apart."""
    at = torch.arange(frames)
    return (at[:, None] - at).abs() <= reach


def _block(width: int, level: int) -> CausalBlock:
    return CausalBlock(width=width, heads=HEADS, lookback=((LOOKBACK + 1) >> level) - 1)


def _see_both_ways(block: nn.Module, x: Tensor) -> Tensor:
    """Run a causal block's weights with a mask that looks ahead as far as back."""
    assert isinstance(block, CausalBlock)
    seen = within(x.shape[1], block.attn.lookback).to(x.device)
    x = x + block.attn.attend_all(block.norm1(x), seen)
    y: Tensor = x + block.mlp(block.norm2(x))
    return y
