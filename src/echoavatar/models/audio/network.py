"""EnCodec's two convolutional networks (Défossez et al. 2022, section 3.1), as layers for `stream.advance`.

The layers only hold weights, under the names of the published checkpoint, so that `facebook/encodec_24khz` loads;
`stream` computes them. A test compares the result with transformers' EnCodec.

May import nothing of the package beyond `config`.
"""

import math

import torch
from torch import nn

from .config import CodecConfig


class CodecNetwork(nn.Module):
    """Encoder or decoder: `layers` in the order of computation; activations are layers of their own."""

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers)
        for module in self.modules():
            if type(module) is nn.Conv1d:
                _initialise(module)


class Convolution(nn.Module):
    """A causal convolution; `stream` supplies what stands before the first input."""

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
