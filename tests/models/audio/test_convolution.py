import pytest
import torch
from torch import nn

from echoavatar.models.audio.convolution import convolve, convolve_transposed, lookback


@pytest.mark.parametrize(
    ("channels", "kernel", "stride", "dilation"),
    [(1, 7, 1, 1), (4, 3, 1, 2), (4, 1, 1, 1), (4, 16, 8, 1), (4, 7, 1, 1)],
)
@pytest.mark.parametrize("has_bias", [True, False])
def test_convolution_equals_torch(channels, kernel, stride, dilation, has_bias):
    conv = nn.Conv1d(channels, 6, kernel, stride, dilation=dilation, bias=has_bias).double()
    x = torch.randn(2, lookback(conv) + 5 * stride, channels, dtype=torch.double)
    torch.testing.assert_close(convolve(conv, x), conv(x.transpose(1, 2)).transpose(1, 2))


@pytest.mark.parametrize(("kernel", "stride"), [(4, 2), (16, 8), (5, 5), (6, 2)])
def test_transposed_convolution_equals_torch_cut_to_the_causal_part(kernel, stride):
    """Torch's output of x behind k zeros starts k strides early and ends kernel - stride samples late."""
    conv = nn.ConvTranspose1d(4, 3, kernel, stride).double()
    x = torch.randn(2, 7, 4, dtype=torch.double)
    whole = conv(x.transpose(1, 2)).transpose(1, 2)[:, : 7 * stride]
    padded = torch.cat([x.new_zeros(2, lookback(conv), 4), x], 1)
    torch.testing.assert_close(convolve_transposed(conv, padded), whole)
