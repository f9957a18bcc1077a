"""EnCodec's two convolutional networks (Défossez et al. 2022, section 3.1) in their exact streaming form.

The layers only hold weights, under the names of the published checkpoint, so that `facebook/encodec_24khz` loads;
`advance` computes them: each convolution keeps its left context, the LSTM its state. Offline, EnCodec pads the input of
each convolution on the left; in a stream the padding is needed only before a row's first chunk; later chunks follow
what the previous one left behind. Encoder chunks are multiples of 320 samples, so the strides always start in phase.

Convolutions are matrix products over frames that stay in memory (channels last). A kernel is a whole number of strides
long, so a strided convolution is a product over blocks of one stride, shifted and summed; transformers' layout
(channels first) costs two to three times as much on a CPU. A test compares the result with transformers' EnCodec.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from echoavatar.models.audio.codec_config import CodecConfig
from echoavatar.nn import StreamState
from echoavatar_lab.nn.stream import write_rows


class CodecNetwork(nn.Module):
    """Encoder or decoder: `layers` in the order of computation; activations are layers of their own."""

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers)
        for module in self.modules():
            if type(module) is nn.Conv1d:
                _initialise(module)


class Convolution(nn.Module):
    """A causal convolution; `Run` supplies the inputs before the first."""

    def __init__(self, conv: nn.Conv1d | nn.ConvTranspose1d) -> None:
        super().__init__()
        self.conv = conv


class Recurrence(nn.Module):
    """An LSTM with a residual connection."""

    def __init__(self, width: int, layers: int) -> None:
        super().__init__()
        self.lstm = nn.LSTM(width, width, layers)


class ResidualBlock(nn.Module):
    """x + convolutions of x, narrower inside."""

    def __init__(self, width: int, dilation: int, config: CodecConfig) -> None:
        super().__init__()
        inner = width // config.compress
        self.block = nn.ModuleList(
            [nn.ELU(), _conv(width, inner, config.residual_kernel, dilation=dilation), nn.ELU(), _conv(inner, width, 1)]
        )
        self.shortcut = _conv(width, width, 1) if config.has_conv_shortcut else nn.Identity()


def encoder(config: CodecConfig) -> CodecNetwork:
    """Sound (1 channel, 24 kHz) to latents (`config.width` channels, 75 per second)."""
    width = config.filters
    layers: list[nn.Module] = [_conv(1, width, config.kernel)]
    for ratio in reversed(config.ratios):
        layers += _residual_blocks(width, config)
        layers += [nn.ELU(), _conv(width, 2 * width, 2 * ratio, stride=ratio)]
        width *= 2
    layers += [Recurrence(width, config.lstm_layers), nn.ELU(), _conv(width, config.width, config.last_kernel)]
    return CodecNetwork(*layers)


def decoder(config: CodecConfig) -> CodecNetwork:
    """Latents to sound: the encoder mirrored."""
    width = config.filters * 2 ** len(config.ratios)
    layers: list[nn.Module] = [_conv(config.width, width, config.kernel), Recurrence(width, config.lstm_layers)]
    for ratio in config.ratios:
        grown = nn.ConvTranspose1d(width, width // 2, 2 * ratio, stride=ratio)
        layers += [nn.ELU(), Convolution(grown)]
        width //= 2
        layers += _residual_blocks(width, config)
    layers += [nn.ELU(), _conv(width, 1, config.last_kernel)]
    return CodecNetwork(*layers)


def _residual_blocks(width: int, config: CodecConfig) -> list[nn.Module]:
    return [ResidualBlock(width, config.dilation_growth**i, config) for i in range(config.residual_blocks)]


def _conv(channels: int, out: int, kernel: int, *, stride: int = 1, dilation: int = 1) -> Convolution:
    return Convolution(nn.Conv1d(channels, out, kernel, stride=stride, dilation=dilation))


def _initialise(conv: nn.Conv1d) -> None:
    """Keeps the loudness of what passes (He et al. 2015); torch's own default lets it shrink from layer to layer."""
    nn.init.kaiming_normal_(conv.weight)
    assert conv.bias is not None
    bound = math.sqrt(1 / (conv.in_channels * conv.kernel_size[0]))
    with torch.no_grad():
        conv.bias.uniform_(-bound, bound)


def lookback(conv: nn.Conv1d | nn.ConvTranspose1d) -> int:
    """Inputs that must stand before a chunk: the memory of a causal layer."""
    if isinstance(conv, nn.ConvTranspose1d):
        return conv.kernel_size[0] // conv.stride[0] - 1
    return (conv.kernel_size[0] - 1) * conv.dilation[0] + 1 - conv.stride[0]


def convolve(conv: nn.Conv1d, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b n d"]:
    """The convolution without padding: x begins with `lookback` old inputs; n = (t - lookback) / stride."""
    kernel, stride, dilation = conv.kernel_size[0], conv.stride[0], conv.dilation[0]
    frames = (x.shape[1] - lookback(conv)) // stride
    taps, rows, channels = kernel // stride, x.shape[0], conv.out_channels
    blocks = x.reshape(rows, -1, stride * conv.in_channels)
    weight = conv.weight.reshape(channels, conv.in_channels, taps, stride)
    if taps <= 3 or conv.in_channels == 1:  # side by side, then one product
        beside = [blocks[:, tap * dilation : tap * dilation + frames] for tap in range(taps)]
        return F.linear(_joined(beside), weight.permute(0, 2, 3, 1).reshape(channels, -1), conv.bias)
    products = F.linear(blocks, weight.permute(2, 0, 3, 1).reshape(taps * channels, -1))
    parts = products.view(rows, -1, taps, channels).unbind(2)
    shifted = [part[:, tap * dilation : tap * dilation + frames] for tap, part in enumerate(parts)]
    total = sum(shifted[1:], shifted[0])
    return total if conv.bias is None else total + conv.bias


def convolve_transposed(conv: nn.ConvTranspose1d, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b t d"]:
    """The transposed convolution, causal: x begins with `lookback` old inputs; t = (n - lookback) stride."""
    stride, old = conv.stride[0], lookback(conv)
    taps, rows, frames = old + 1, x.shape[0], x.shape[1] - old
    beside = [x[:, old - tap : old - tap + frames] for tap in range(taps)]
    weight = conv.weight.reshape(conv.in_channels, conv.out_channels, taps, stride).permute(3, 1, 2, 0)
    out = F.linear(_joined(beside), weight.reshape(stride * conv.out_channels, -1))
    out = out.view(rows, frames * stride, conv.out_channels)
    return out if conv.bias is None else out + conv.bias


def _joined(parts: list[Tensor]) -> Tensor:
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=2)


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
        """The output of the last of these layers; each reads the output of the one before."""
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
