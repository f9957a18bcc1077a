"""The tokenizers of the paper's ablation: convolutions, and one path between the levels.

A block of convolutions, the paper's baseline (CausalConv-RVQ), has three residual units of dilation 1, 3 and 9, as
motion VQ-VAEs usually have (T2M-GPT), padded on the left only. It has the weights of an attention block of the same
width, 12 width^2, and sees 26 positions back. `MotionTokenizerConfig.blocks` and `.resampling` choose.
"""

from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar.nn import StreamState
from echoavatar_lab.models.tokenizer.model import BodyTokenizer, MotionTokenizer
from echoavatar_lab.nn.blocks import Mlp
from echoavatar_lab.nn.stream import StreamingModule, write_rows

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


class AnyTokenizer(MotionTokenizer):
    """The tokenizer of one part, in the variant that its config names."""

    def block(self, level: int) -> StreamingModule[Any]:
        """See `MotionTokenizer.block`."""
        return CausalConvBlock(width=self.config.width) if self.config.blocks == "convolution" else super().block(level)

    def resampler(self, inputs: int, outputs: int) -> nn.Module:
        """See `MotionTokenizer.resampler`. A linear layer here is a convolution of stride 2 and kernel 2."""
        if self.config.resampling == "strided":
            return nn.Linear(inputs, outputs)
        return Mlp(inputs=inputs, hidden=4 * self.config.width, outputs=outputs)

    def both_paths(self, learned: Float[Tensor, "b n c"], short: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """See `MotionTokenizer.both_paths`."""
        return super().both_paths(learned, short) if self.config.resampling == "dual" else learned


class AnyBodyTokenizer(BodyTokenizer):
    """`BodyTokenizer` in every variant."""

    part_type = AnyTokenizer
