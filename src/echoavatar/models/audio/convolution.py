"""EnCodec's convolutions as matrix products over frames that stay in memory (channels last).

A kernel is a whole number of strides long, so a strided convolution is a product over blocks of one stride, shifted
and summed; transformers' layout (channels first) costs two to three times as much on a CPU.

May import nothing of the package.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


def lookback(conv: nn.Conv1d | nn.ConvTranspose1d) -> int:
    """Inputs that must stand before a chunk: what a causal layer remembers."""
    if isinstance(conv, nn.ConvTranspose1d):
        return conv.kernel_size[0] // conv.stride[0] - 1
    return (conv.kernel_size[0] - 1) * conv.dilation[0] + 1 - conv.stride[0]


def convolve(conv: nn.Conv1d, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b n d"]:
    """The convolution without padding: x begins with `lookback` old inputs; n = (t - lookback) / stride."""
    kernel, stride, dilation = conv.kernel_size[0], conv.stride[0], conv.dilation[0]
    frames = (x.shape[1] - lookback(conv)) // stride
    if conv.in_channels == 1 and stride == 1 and dilation == 1:
        return F.linear(x.squeeze(2).unfold(1, kernel, 1), conv.weight.squeeze(1), conv.bias)
    taps, rows, channels = kernel // stride, x.shape[0], conv.out_channels
    blocks = x.reshape(rows, -1, stride * conv.in_channels)
    weight = conv.weight.reshape(channels, conv.in_channels, taps, stride)
    if taps <= 3:  # side by side, then one product
        beside = [blocks[:, tap * dilation : tap * dilation + frames] for tap in range(taps)]
        return F.linear(_joined(beside), weight.permute(0, 2, 3, 1).reshape(channels, -1), conv.bias)
    products = F.linear(blocks, weight.permute(2, 0, 3, 1).reshape(taps * channels, -1))
    parts = products.view(rows, -1, taps, channels).unbind(2)
    shifted = [part[:, tap * dilation : tap * dilation + frames] for tap, part in enumerate(parts)]
    return _total(shifted) if conv.bias is None else _total(shifted) + conv.bias


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


def _total(parts: list[Tensor]) -> Tensor:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total
