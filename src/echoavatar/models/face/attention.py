"""Causal attention whose keys and values are kept while the frames of a chunk are generated one by one.

Three kinds of positions: a learned bias by distance (ours; the past can then be kept for ever, in a ring), and
the two of the release, which need positions counted from the start of the window: rotary on the whole vector before
the projection, and sinusoids added to it.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from echoavatar.nn.rotary import rotary_phases


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
        """As in `Attention`, with positions."""
        weight, bias, width = self.qkv.weight, self.qkv.bias, self.width
        qk = F.linear(rotate_pairs(x, at), weight[: 2 * width], bias[: 2 * width])
        v = F.linear(x, weight[2 * width :], bias[2 * width :])
        return qk[..., :width], torch.cat([qk[..., width:], v], -1)


class SinusoidAttention(Attention):
    """Sinusoids are added to what becomes queries, keys and values (release)."""

    def project(self, x: Float[Tensor, "r t c"], at: int) -> tuple[Tensor, Tensor]:
        """As in `Attention`, with positions."""
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
