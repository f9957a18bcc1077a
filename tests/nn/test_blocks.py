import torch

from echoavatar.nn import CausalBlock, FullBlock, Mlp
from echoavatar.nn.blocks import CausalConvBlock, CausalConvolution


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


def test_a_block_is_two_pre_norm_residuals():
    """With both output projections at zero the block is the identity."""
    block = CausalBlock(width=16, heads=2, lookback=3)
    for layer in (block.attn.proj, block.mlp.fc2):
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    x = torch.randn(1, 5, 16)
    assert torch.equal(block(x), x)


def test_mlp_uses_the_exact_gelu():
    """Identity weights: gelu(1) = Phi(1) = 0.841345 (the tanh approximation gives 0.841192)."""
    mlp = Mlp(inputs=1, hidden=1, outputs=1).double()
    for layer in (mlp.fc1, mlp.fc2):
        torch.nn.init.ones_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    torch.testing.assert_close(mlp(torch.ones(1, 1, dtype=torch.double)).item(), 0.841345, atol=1e-6, rtol=0)


@torch.no_grad()
def test_a_full_block_is_a_causal_one_that_looks_both_ways():
    """The same weights under a mask that hides nothing, and the last frame of a causal block that sees everything."""
    torch.manual_seed(0)
    causal, full = CausalBlock(width=16, heads=2, lookback=9).double(), FullBlock(width=16, heads=2).double()
    full.load_state_dict({key.removeprefix("attn."): value for key, value in causal.state_dict().items()})
    x = torch.randn(2, 9, 16, generator=torch.Generator().manual_seed(4), dtype=torch.double)
    q, k, v = causal.attn._project(causal.norm1(x)).unbind(2)
    mixed = x + causal.attn._attend(q, k, v, torch.ones(9, 9, dtype=torch.bool))
    torch.testing.assert_close(full(x), mixed + causal.mlp(causal.norm2(mixed)), atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(full(x)[:, -1], causal(x)[:, -1], atol=1e-6, rtol=1e-6)


def test_every_frame_sees_every_other():
    """By gradient: the output at frame 3 depends on all frames, before and after."""
    torch.manual_seed(0)
    block, x = FullBlock(width=16, heads=2), torch.randn(1, 7, 16, requires_grad=True)
    block(x)[0, 3].sum().backward()
    assert (x.grad.abs().sum((0, 2)) > 1e-6).all()


def test_order_matters():
    torch.manual_seed(0)
    block, x = FullBlock(width=16, heads=2), torch.randn(1, 7, 16)
    turned = block(x.flip(1)).flip(1)
    assert (block(x) - turned).abs().max() > 1e-3
