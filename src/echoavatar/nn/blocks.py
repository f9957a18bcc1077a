"""Blocks over frames: of a transformer, and of causal convolutions, the paper's baseline for them (CausalConv-RVQ).

Transformer blocks are pre-norm, over causal look-back attention (paper, Motion Tokenizer) or over a whole clip. A block
of convolutions has three residual units of dilation 1, 3 and 9, as motion VQ-VAEs usually have (T2M-GPT), padded on the
left only; it has the weights of an attention block of the same width, 12 width^2, and sees 26 positions back.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from .attention import AttentionState, CausalAttention, rotary, rotary_table
from .stream import StreamingModule, StreamState, write_rows

KERNEL = 3
DILATIONS = (1, 3, 9)


@dataclass
class ConvolutionState(StreamState):
    """The last inputs of a convolution, oldest first; zeros before the first."""

    past: Float[Tensor, "b p c"]


@dataclass
class ConvolutionBlockState(StreamState):
    """Past of each unit."""

    units: list[ConvolutionState]


class CausalConvolution(StreamingModule[ConvolutionState]):
    """A dilated convolution over the present position and past ones; channels last."""

    def __init__(self, *, width: int, dilation: int) -> None:
        super().__init__()
        self.conv = nn.Conv1d(width, width, KERNEL, dilation=dilation)
        self.past = (KERNEL - 1) * dilation

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """The whole clip at once, zeros before it."""
        return self._convolve(F.pad(x, (0, 0, self.past, 0)))

    def init_state(self, rows: int) -> ConvolutionState:
        """Nothing seen yet."""
        weight = self.conv.weight.detach()
        return ConvolutionState(weight.new_zeros(rows, self.past, weight.shape[1]))

    def step(
        self, x: Float[Tensor, "b t c"], state: ConvolutionState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b t c"]:
        """The next frames of running clips."""
        whole = torch.cat([state.past, x.to(state.past.dtype)], 1)
        write_rows(state.past, whole[:, x.shape[1] :], active)
        return self._convolve(whole.to(x.dtype))

    def _convolve(self, x: Tensor) -> Tensor:
        y: Tensor = self.conv(x.transpose(1, 2))
        return y.transpose(1, 2)


class CausalConvBlock(StreamingModule[ConvolutionBlockState]):
    """Per unit: x + Linear(gelu(Convolution(gelu(x))))."""

    def __init__(self, *, width: int) -> None:
        super().__init__()
        self.convs = nn.ModuleList(CausalConvolution(width=width, dilation=d) for d in DILATIONS)
        self.mixers = nn.ModuleList(nn.Linear(width, width) for _ in DILATIONS)

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """The whole clip at once."""
        for conv, mix in zip(self.convs, self.mixers, strict=True):
            x = x + mix(F.gelu(conv(F.gelu(x))))
        return x

    def init_state(self, rows: int) -> ConvolutionBlockState:
        """Nothing seen yet."""
        return ConvolutionBlockState([conv.init_state(rows) for conv in self._convolutions()])

    def step(
        self, x: Float[Tensor, "b t c"], state: ConvolutionBlockState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b t c"]:
        """The next frames of running clips."""
        for conv, mix, past in zip(self._convolutions(), self.mixers, state.units, strict=True):
            x = x + mix(F.gelu(conv.step(F.gelu(x), past, active)))
        return x

    def _convolutions(self) -> list[CausalConvolution]:
        return [conv for conv in self.convs if isinstance(conv, CausalConvolution)]


class Mlp(nn.Module):
    """Linear, GELU (erf), linear; frame by frame."""

    def __init__(self, *, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(inputs, hidden)
        self.fc2 = nn.Linear(hidden, outputs)

    def forward(self, x: Float[Tensor, "*b c"]) -> Float[Tensor, "*b d"]:
        """Apply to the last axis."""
        y: Tensor = self.fc2(F.gelu(self.fc1(x)))
        return y


class CausalBlock(StreamingModule[AttentionState]):
    """x + Attention(norm(x)), then x + MLP(norm(x)); no norm at the end."""

    def __init__(self, *, width: int, heads: int, lookback: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width)
        self.attn = CausalAttention(width=width, heads=heads, lookback=lookback)
        self.norm2 = nn.LayerNorm(width)
        self.mlp = Mlp(inputs=width, hidden=4 * width, outputs=width)

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """The whole clip at once."""
        return self._finish(x + self.attn(self.norm1(x)))

    def init_state(self, rows: int) -> AttentionState:
        """Nothing seen yet."""
        return self.attn.init_state(rows)

    def step(
        self, x: Float[Tensor, "b t c"], state: AttentionState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b t c"]:
        """The next frames of running clips."""
        return self._finish(x + self.attn.step(self.norm1(x), state, active))

    def _finish(self, x: Tensor) -> Tensor:
        y: Tensor = x + self.mlp(self.norm2(x))
        return y


class FullBlock(nn.Module):
    """x + Attention(norm(x)), then x + MLP(norm(x)); every frame sees every other (rotary positions)."""

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
        """The whole clip."""
        split = (x.shape[0], x.shape[1], 3, self.heads, -1)
        q, k, v = self.qkv(self.norm1(x)).view(split).permute(2, 0, 3, 1, 4)
        table = rotary_table(x.shape[1], q.shape[-1]).to(q)
        mixed = F.scaled_dot_product_attention(rotary(q, table), rotary(k, table), v)
        x = x + self.proj(mixed.transpose(1, 2).flatten(2))
        y: Tensor = x + self.mlp(self.norm2(x))
        return y
