"""The exact streaming form of EnCodec's encoder: every convolution keeps its left context, the LSTM its state.

Offline, EnCodec pads the input of each convolution on the left; in a stream that padding is needed once per row,
at its first chunk, and is what the last chunk left behind ever after. Chunks are multiples of 320 samples, so the
strides always start in phase.

May import `nn` and below.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from ..nn import StreamState, write_rows


@dataclass
class ConvPast(StreamState):
    """The last inputs of one convolution."""

    inputs: Float[Tensor, "b c k"]


@dataclass
class EncoderState(StreamState):
    """What the encoder remembers: left contexts, LSTM state, and the frames seen so far (0: a fresh row)."""

    convolutions: list[ConvPast]
    hidden: Float[Tensor, "b l c"]
    cell: Float[Tensor, "b l c"]
    seen: Int[Tensor, " b"]


def init_encoder_state(encoder: nn.Module, rows: int) -> EncoderState:
    """A state of zeros for `rows` sessions of a transformers `EncodecEncoder`."""
    like = next(encoder.parameters())
    lstm = next(module for module in encoder.modules() if isinstance(module, nn.LSTM))
    pasts = [
        ConvPast(like.new_zeros(rows, conv.in_channels, _lookback(conv)))
        for conv in encoder.modules()
        if isinstance(conv, nn.Conv1d) and _lookback(conv)
    ]
    cells = like.new_zeros(rows, lstm.num_layers, lstm.hidden_size)
    return EncoderState(pasts, cells, cells.clone(), torch.zeros(rows, dtype=torch.int64, device=like.device))


def advance_encoder(
    encoder: nn.Module,
    audio: Float[Tensor, "b s"],
    state: EncoderState,
    active: Bool[Tensor, " b"],
    *,
    padding: str,
) -> Float[Tensor, "b n c"]:
    """Latents of the next samples; `state` moves on in place, in the active rows only.

    A first chunk that is shorter than a reflection is padded with zeros on the right before it is reflected, as
    EnCodec does offline; such a row must not be continued (`AudioCodec.step` refuses it).
    """
    run = _Run(iter(state.convolutions), state, active, state.seen == 0, padding)
    latents = run.layers(encoder.layers, audio.unsqueeze(1)).transpose(1, 2)
    write_rows(state.seen, state.seen + latents.shape[1], active)
    return latents


def shortest_start(encoder: nn.Module, padding: str) -> int:
    """Frames that the first chunk of a row must have at least."""
    if padding != "reflect":
        return 1
    total, needed = 1, 1  # input samples per sample of the layer; frames
    strides = [conv.stride[0] for conv in encoder.modules() if isinstance(conv, nn.Conv1d)]
    hop = int(torch.tensor(strides).prod())
    for conv in encoder.modules():
        if isinstance(conv, nn.Conv1d):
            needed = max(needed, -(-(_lookback(conv) + 1) * total // hop))
            total *= conv.stride[0]
    return needed


def _lookback(conv: nn.Conv1d) -> int:
    return (conv.kernel_size[0] - 1) * conv.dilation[0] + 1 - conv.stride[0]


@dataclass
class _Run:
    """One pass through the layers, in the order in which the state lists them."""

    pasts: Iterator[ConvPast]
    state: EncoderState
    active: Tensor
    fresh: Tensor
    padding: str

    def layers(self, layers: nn.Module, x: Tensor) -> Tensor:
        for layer in layers.children():
            x = self.layer(layer, x)
        return x

    def layer(self, layer: nn.Module, x: Tensor) -> Tensor:
        conv, lstm = getattr(layer, "conv", None), getattr(layer, "lstm", None)
        if isinstance(conv, nn.Conv1d):
            return self.convolve(conv, x)
        if isinstance(lstm, nn.LSTM):
            return self.recur(lstm, x)
        if hasattr(layer, "block"):
            inner = self.layers(layer.block, x)
            return inner + (self.layer(layer.shortcut, x) if layer.shortcut is not None else x)
        return layer(x)  # type: ignore[no-any-return]

    def convolve(self, conv: nn.Conv1d, x: Tensor) -> Tensor:
        keep = _lookback(conv)
        if keep:
            past = next(self.pasts).inputs
            left = past
            if self.padding == "reflect":
                left = torch.where(self.fresh[:, None, None], _reflection(x, keep), past)
            x = torch.cat([left, x], dim=2)
            write_rows(past, x[..., -keep:], self.active)
        return F.conv1d(x, conv.weight, conv.bias, stride=conv.stride, dilation=conv.dilation)

    def recur(self, lstm: nn.LSTM, x: Tensor) -> Tensor:
        frames = x.permute(2, 0, 1)
        before = (self.state.hidden.transpose(0, 1).contiguous(), self.state.cell.transpose(0, 1).contiguous())
        out, (hidden, cell) = lstm(frames, before)
        write_rows(self.state.hidden, hidden.transpose(0, 1), self.active)
        write_rows(self.state.cell, cell.transpose(0, 1), self.active)
        return (out + frames).permute(1, 2, 0)


def _reflection(x: Tensor, length: int) -> Tensor:
    """The `length` samples that mirror x[1:] before x[0]."""
    missing = length + 1 - x.shape[-1]
    if missing > 0:
        x = F.pad(x, (0, missing))
    return x[..., 1 : length + 1].flip(-1)
