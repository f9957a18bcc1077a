"""The causal backbone: motion so far and sound in, a condition for the next frame out.

Paper, Face Animation Generator: "causal GPT backbone with 4 transformer decoder blocks (hidden size 256, 8 attention
heads, MLP ratio 4) that autoregressively processes motion history conditioned on audio features". There is no
cross-attention: sound is added, index by index. Input k is frame k and the sound of frame k + 1.

Two forms. `window` is the release's: two attentions per block with positions from the start of the window (one rotates
the whole vector before the projection, one adds sinusoids to it), so the history is read anew for every chunk. `ring`
is ours: one attention with a learned bias by distance, keys and values kept between chunks. Within a chunk both keep
keys and values while its frames are generated one by one.
"""

from typing import cast

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from echoavatar.models.face import FaceConfig
from echoavatar_lab.nn.attention import rotary_phases
from echoavatar_lab.nn.blocks import Mlp


class Attention(nn.Module):
    """Multi-head attention over everything before, and itself. A cache (r n 2c) holds keys and values of positions."""

    def __init__(self, *, width: int, heads: int) -> None:
        super().__init__()
        self.width, self.heads = width, heads
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """A whole window."""
        q, kv = self.project(x, 0)
        return self.attend(q, kv, is_causal=True)

    def extend(self, x: Float[Tensor, "r t c"], cache: Float[Tensor, "r n d"], at: int) -> Float[Tensor, "r t c"]:
        """The positions `at`, `at` + 1 ..; only the first call may bring more than one."""
        assert at == 0 or x.shape[1] == 1
        q, kv = self.project(x, at)
        end = at + x.shape[1]
        cache[:, at:end] = kv
        return self.attend(q, cache[:, :end], is_causal=x.shape[1] > 1)

    def project(self, x: Float[Tensor, "r t c"], at: int) -> tuple[Tensor, Tensor]:
        """Queries (r t c), keys and values side by side (r t 2c), of inputs at positions `at` and on."""
        qkv = F.linear(x, self.qkv.weight, self.qkv.bias)
        return qkv[..., : self.width], qkv[..., self.width :]

    def attend(
        self, q: Tensor, kv: Tensor, *, mask: Tensor | None = None, is_causal: bool = False
    ) -> Float[Tensor, "r t c"]:
        """Weighted values through the output projection."""
        rows, frames, _ = q.shape
        q = q.view(rows, frames, self.heads, -1).transpose(1, 2)
        k, v = kv.view(rows, kv.shape[1], 2, self.heads, -1).permute(2, 0, 3, 1, 4).unbind()
        y = F.scaled_dot_product_attention(q, k, v, attn_mask=mask, is_causal=is_causal)
        return F.linear(y.transpose(1, 2).reshape(rows, frames, -1), self.proj.weight, self.proj.bias)


class RotaryVectorAttention(Attention):
    """Queries and keys are projected from the rotated vector, values from the unrotated one (release)."""

    def project(self, x: Float[Tensor, "r t c"], at: int) -> tuple[Tensor, Tensor]:
        """See `Attention.project`; inputs carry their positions."""
        weight, bias, width = self.qkv.weight, self.qkv.bias, self.width
        qk = F.linear(rotate_pairs(x, at), weight[: 2 * width], bias[: 2 * width])
        v = F.linear(x, weight[2 * width :], bias[2 * width :])
        return qk[..., :width], torch.cat([qk[..., width:], v], -1)


class SinusoidAttention(Attention):
    """Sinusoids are added to what becomes queries, keys and values (release)."""

    def project(self, x: Float[Tensor, "r t c"], at: int) -> tuple[Tensor, Tensor]:
        """See `Attention.project`; inputs carry their positions."""
        return super().project(x + sinusoids(x, at), at)


class RingAttention(Attention):
    """Sees itself and `lookback` frames; how far back they lie adds a learned bias to the scores."""

    def __init__(self, *, width: int, heads: int, lookback: int) -> None:
        super().__init__(width=width, heads=heads)
        self.lookback = lookback
        slopes = 2.0 ** -torch.arange(1, heads + 1)
        self.bias = nn.Parameter(slopes[:, None] * torch.arange(-lookback, 1))  # the last column is the frame itself

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """A whole window."""
        q, kv = self.project(x, 0)
        position = torch.arange(x.shape[1], device=x.device)
        distance = position - position[:, None]
        seen = (distance <= 0) & (distance >= -self.lookback)
        bias = self.bias[:, (distance + self.lookback).clamp(0, self.lookback)]
        return self.attend(q, kv, mask=bias.masked_fill(~seen, -torch.inf)[None])


def rotate_pairs(x: Float[Tensor, "r t c"], at: int) -> Float[Tensor, "r t c"]:
    """Rotate neighbouring channels together by the phases of their position."""
    phases = _phases(x, at)
    cos, sin = phases.cos().to(x), phases.sin().to(x)
    even, odd = x[..., 0::2], x[..., 1::2]
    return torch.stack([even * cos - odd * sin, even * sin + odd * cos], -1).flatten(-2)


def sinusoids(x: Float[Tensor, "r t c"], at: int) -> Float[Tensor, "t c"]:
    """Sine at even, cosine at odd channels."""
    phases = _phases(x, at)
    return torch.stack([phases.sin(), phases.cos()], -1).flatten(-2).to(x)


def _phases(x: Float[Tensor, "r t c"], at: int) -> Float[Tensor, "t half"]:
    return rotary_phases(torch.arange(at, at + x.shape[1], device=x.device), width=x.shape[2])


class WindowBlock(nn.Module):
    """Attention, then sound, attention and MLP; each reads a normalised input."""

    def __init__(self, *, width: int, heads: int) -> None:
        super().__init__()
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.norm3, self.norm4 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attn1 = RotaryVectorAttention(width=width, heads=heads)
        self.attn2 = SinusoidAttention(width=width, heads=heads)
        self.mlp = Mlp(inputs=width, hidden=4 * width, outputs=width)

    def forward(self, x: Float[Tensor, "b t c"], sound: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """A whole window."""
        x = x + self.attn1(self.norm1(x))
        x = x + self.norm2(x) + sound
        x = x + self.attn2(self.norm3(x))
        return x + cast(Tensor, self.mlp(self.norm4(x)))

    def extend(self, x: Tensor, sound: Tensor, caches: tuple[Tensor, Tensor], at: int) -> Float[Tensor, "r t c"]:
        """The next positions; each attention has a cache."""
        x = x + self.attn1.extend(self.norm1(x), caches[0], at)
        x = x + self.norm2(x) + sound
        x = x + self.attn2.extend(self.norm3(x), caches[1], at)
        return x + cast(Tensor, self.mlp(self.norm4(x)))


class RingBlock(nn.Module):
    """Sound, attention, MLP."""

    def __init__(self, *, width: int, heads: int, lookback: int) -> None:
        super().__init__()
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attn = RingAttention(width=width, heads=heads, lookback=lookback)
        self.mlp = Mlp(inputs=width, hidden=4 * width, outputs=width)

    def forward(self, x: Float[Tensor, "b t c"], sound: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """A whole window."""
        x = x + sound
        x = x + self.attn(self.norm1(x))
        return x + cast(Tensor, self.mlp(self.norm2(x)))


class FaceGpt(nn.Module):
    """Embedding, blocks, norm, projection."""

    def __init__(self, config: FaceConfig) -> None:
        super().__init__()
        self.config = config
        width, heads = config.width, config.heads
        self.sound_proj = nn.Linear(config.encoder.outputs, width)
        self.embed = nn.Linear(config.channels, width)
        self.blocks = nn.ModuleList(
            WindowBlock(width=width, heads=heads)
            if config.memory == "window"
            else RingBlock(width=width, heads=heads, lookback=config.context - 1)
            for _ in range(config.layers)
        )
        self.output_norm = nn.LayerNorm(width)
        self.output_proj = nn.Linear(width, config.condition)

    def forward(self, motion: Float[Tensor, "b t c"], sound: Float[Tensor, "b t w"]) -> Float[Tensor, "b t d"]:
        """Conditions of the frames that follow each of `motion`; `sound` went through `sound_proj`."""
        x = self.embed(motion)
        for block in self.blocks:
            x = block(x, sound)
        return self.condition(x)

    def condition(self, x: Float[Tensor, "*b c"]) -> Float[Tensor, "*b d"]:
        """What the head is told by the last block's output."""
        y: Tensor = self.output_proj(self.output_norm(x))
        return y
