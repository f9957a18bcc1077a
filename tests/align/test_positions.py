"""Position encodings by hand."""

import torch

from echoavatar.align.positions import sinusoids


def test_sinusoids_by_hand():
    """Position 1 of width 4: sin 1, cos 1, sin 0.01, cos 0.01."""
    one = torch.tensor(1.0)
    wanted = torch.stack([one.sin(), one.cos(), (one / 100).sin(), (one / 100).cos()])
    torch.testing.assert_close(sinusoids(2, 4)[1], wanted)
