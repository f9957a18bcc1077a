"""The exact streaming form of EnCodec's networks: each convolution keeps its left context, the LSTM its state.

Offline, EnCodec pads the input of each convolution on the left; in a stream the padding is needed only
before a row's first chunk; later chunks follow what the previous one left behind. Encoder chunks are multiples of 320
samples, so the strides always start in phase.

May import `network`, `nn` and below.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from echoavatar.nn import StreamState, write_rows

from .convolution import convolve, convolve_transposed, lookback
from .network import CodecNetwork, Convolution, Recurrence, ResidualBlock


@dataclass
class ConvolutionPast(StreamState):
    """The last inputs of one convolution."""

    inputs: Float[Tensor, "b k c"]


@dataclass
class NetworkState(StreamState):
    """The past of an encoder or decoder; `seen` counts its inputs (0: a fresh row)."""

    convolutions: list[ConvolutionPast]
    hidden: Float[Tensor, "b l c"]
    cell: Float[Tensor, "b l c"]
    seen: Int[Tensor, " b"]


def init_network_state(network: CodecNetwork, rows: int) -> NetworkState:
    """A state of zeros for `rows` sessions of an encoder or a decoder (see `network`)."""
    like = next(network.parameters())
    lstm = next(module for module in network.modules() if isinstance(module, nn.LSTM))
    pasts = [
        ConvolutionPast(like.new_zeros(rows, lookback(conv), conv.in_channels))
        for conv in _convolutions(network)
        if lookback(conv)
    ]
    cells = like.new_zeros(rows, lstm.num_layers, lstm.hidden_size)
    return NetworkState(pasts, cells, cells.clone(), torch.zeros(rows, dtype=torch.int64, device=like.device))


def advance(
    network: CodecNetwork, x: Float[Tensor, "b t c"], state: NetworkState, active: Bool[Tensor, " b"], *, padding: str
) -> Float[Tensor, "b n d"]:
    """Outputs for the next inputs; `state` moves on in place, in the active rows only.

    Differentiable within the call. A first chunk that is shorter than a reflection is padded with zeros on the
    right before it is reflected, as EnCodec does offline; such a row must not be continued.
    """
    run = Run(iter(state.convolutions), state, active, state.seen == 0, padding)
    out = run.layers(network.layers, x)
    write_rows(state.seen, state.seen + x.shape[1], active)
    return out


def open_run(network: CodecNetwork, rows: int, *, padding: str) -> "Run":
    """A pass of fresh rows, for who wants the output of each layer."""
    state = init_network_state(network, rows)
    return Run(iter(state.convolutions), state, state.seen == 0, state.seen == 0, padding)


def shortest_start(encoder: CodecNetwork, padding: str) -> int:
    """Frames that the first chunk of a row must have at least."""
    if padding != "reflect":
        return 1
    hop, needed, scale = 1, 1, 1
    for conv in _convolutions(encoder):
        hop *= conv.stride[0]
    for conv in _convolutions(encoder):
        needed = max(needed, -(-(lookback(conv) + 1) * scale // hop) if lookback(conv) else 1)
        scale *= conv.stride[0]
    return needed


def _convolutions(network: CodecNetwork) -> list[nn.Conv1d | nn.ConvTranspose1d]:
    return [module for module in network.modules() if isinstance(module, nn.Conv1d | nn.ConvTranspose1d)]


@dataclass
class Run:
    """One pass through the layers, in the order in which the state lists them."""

    pasts: Iterator[ConvolutionPast]
    state: NetworkState
    active: Tensor
    fresh: Tensor
    padding: str

    def layers(self, layers: nn.Module, x: Tensor) -> Tensor:
        """The layers' outputs of x, each of the one before."""
        for layer in layers.children():
            x = self.layer(layer, x)
        return x

    def layer(self, layer: nn.Module, x: Tensor) -> Tensor:
        """One layer's output (b n d) of its inputs x (b t c)."""
        if isinstance(layer, nn.ELU):
            return F.elu(x)
        if isinstance(layer, Recurrence):
            return self._recur(layer.lstm, x)
        if isinstance(layer, ResidualBlock):
            inner = self.layers(layer.block, x)
            return inner + self.layer(layer.shortcut, x)
        if not isinstance(layer, Convolution):  # an identity
            return x
        conv = layer.conv
        if isinstance(conv, nn.ConvTranspose1d):
            return convolve_transposed(conv, self._remember(x, lookback(conv), padding="constant"))
        return convolve(conv, self._remember(x, lookback(conv), padding=self.padding))

    def _remember(self, x: Tensor, length: int, *, padding: str) -> Tensor:
        """`x` behind the last inputs, which `x` then becomes."""
        if not length:
            return x
        past = next(self.pasts).inputs
        left = past.clone()
        if padding == "reflect":
            left = torch.where(self.fresh[:, None, None], _reflection(x, length), left)
        x = torch.cat([left, x], dim=1)
        write_rows(past, x[:, -length:].detach(), self.active)
        return x

    def _recur(self, lstm: nn.LSTM, x: Tensor) -> Tensor:
        frames = x.transpose(0, 1)
        hidden, cell = (part.transpose(0, 1).clone() for part in (self.state.hidden, self.state.cell))
        out, (hidden, cell) = lstm(frames, (hidden.contiguous(), cell.contiguous()))
        write_rows(self.state.hidden, hidden.transpose(0, 1).detach(), self.active)
        write_rows(self.state.cell, cell.transpose(0, 1).detach(), self.active)
        after: Tensor = out.transpose(0, 1) + x
        return after


def _reflection(x: Tensor, length: int) -> Tensor:
    """The `length` inputs that mirror x[1:] before x[0]."""
    missing = length + 1 - x.shape[1]
    if missing > 0:
        x = F.pad(x, (0, 0, 0, missing))
    return x[:, 1 : length + 1].flip(1)
