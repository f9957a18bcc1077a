import torch

from echoavatar_lab.nn.blocks import CausalBlock, FullBlock, Mlp


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
