"""Every frame sees every other, and order matters."""

import torch

from echoavatar.align.bidirectional import FullBlock, sinusoids


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


def test_sinusoids_by_hand():
    """Position 1 of width 4: sin 1, cos 1, sin 0.01, cos 0.01."""
    one = torch.tensor(1.0)
    wanted = torch.stack([one.sin(), one.cos(), (one / 100).sin(), (one / 100).cos()])
    torch.testing.assert_close(sinusoids(2, 4)[1], wanted)
