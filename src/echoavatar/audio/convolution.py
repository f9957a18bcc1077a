"""EnCodec's convolutions as matrix products over frames that stay in memory (channels last).

A kernel is a whole number of strides long, so a strided convolution is a product over blocks of one stride, shifted
and summed; transformers' layout (channels first) costs two to three times as much on a CPU.

May import nothing of the package.
"""

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
    taps = kernel // stride
    blocks = x.reshape(x.shape[0], -1, stride * conv.in_channels)
    weight = conv.weight.unflatten(2, (taps, stride)).permute(2, 0, 3, 1)  # taps out stride in
    products = F.linear(blocks, weight.reshape(taps * conv.out_channels, -1)).unflatten(2, (taps, -1))
    out = products[:, :frames, 0] if conv.bias is None else products[:, :frames, 0] + conv.bias
    for tap in range(1, taps):
        out = out + products[:, tap * dilation : tap * dilation + frames, tap]
    return out


def convolve_transposed(conv: nn.ConvTranspose1d, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b t d"]:
    """The transposed convolution, causal: x begins with `lookback` old inputs; t = (n - lookback) stride."""
    stride, old = conv.stride[0], lookback(conv)
    taps, frames = old + 1, x.shape[1] - old
    weight = conv.weight.unflatten(2, (taps, stride)).permute(2, 3, 1, 0)  # taps stride out in
    products = F.linear(x, weight.reshape(taps * stride * conv.out_channels, -1)).unflatten(2, (taps, -1))
    out = products[:, old:, 0]
    for tap in range(1, taps):
        out = out + products[:, old - tap : old - tap + frames, tap]
    out = out.reshape(x.shape[0], frames * stride, conv.out_channels)
    return out if conv.bias is None else out + conv.bias
