import torch

from echoavatar.nn import CausalBlock
from echoavatar.nn.convolution import CausalConvBlock, CausalConvolution


def frames(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(rows, length, 16, generator=generator, dtype=torch.double)


def test_a_convolution_sees_the_present_and_two_dilated_steps_back():
    """With weights of one the answer to a unit impulse at 0 is one at 0, 3 and 6."""
    conv = CausalConvolution(width=1, dilation=3)
    torch.nn.init.ones_(conv.conv.weight)
    torch.nn.init.zeros_(conv.conv.bias)
    x = torch.zeros(1, 9, 1)
    x[0, 0] = 1
    assert conv(x)[0, :, 0].nonzero().flatten().tolist() == [0, 3, 6]


def test_a_block_sees_26_positions_back():
    block = CausalConvBlock(width=16).double()
    x = frames(1, 40, torch.Generator().manual_seed(0)).requires_grad_()
    block(x)[0, 35].sum().backward()
    assert x.grad[0].abs().sum(-1).nonzero().flatten().tolist()[0] == 35 - 26


def test_it_weighs_what_an_attention_block_does():
    def matrices(block: torch.nn.Module) -> int:
        return sum(p.numel() for p in block.parameters() if p.dim() > 1)

    assert matrices(CausalConvBlock(width=32)) == matrices(CausalBlock(width=32, heads=2, lookback=3))
