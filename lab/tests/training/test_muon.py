import pytest
import torch
from torch import nn

from echoavatar_lab.training import muon
from echoavatar_lab.training.muon import Muon, multiplies_bfloat16, orthogonalised

COEFFICIENTS = (3.4445, -4.7750, 2.0315)  # torch's


def learn(monkeypatch: pytest.MonkeyPatch, *, is_fast: bool) -> list[nn.Parameter]:
    """Weights of a tall and a wide matrix after five steps."""
    monkeypatch.setattr(muon, "multiplies_bfloat16", lambda device: is_fast)
    torch.manual_seed(0)
    matrices = [nn.Parameter(torch.randn(24, 8)), nn.Parameter(torch.randn(8, 24))]
    optimiser = Muon(matrices, rate=0.02, weight_decay=0.1)
    target = [torch.randn(24, 8), torch.randn(8, 24)]
    for _ in range(5):
        loss = sum(((m - t) ** 2).sum() for m, t in zip(matrices, target, strict=True))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return matrices


def test_steps_are_torchs():
    torch.manual_seed(0)
    sides = [(24, 8), (8, 24), (24, 8)]
    ours, theirs = ([nn.Parameter(torch.ones(side)) for side in sides] for _ in range(2))
    optimisers = [
        Muon(ours, rate=0.02, weight_decay=0.1),
        torch.optim.Muon(theirs, lr=0.02, weight_decay=0.1, adjust_lr_fn="match_rms_adamw"),
    ]
    for _ in range(3):
        for one, other in zip(ours, theirs, strict=True):
            one.grad = torch.randn_like(one)
            other.grad = one.grad.clone()
        for optimiser in optimisers:
            optimiser.step()
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, atol=2e-3, rtol=0)
    assert optimisers[0].state[ours[0]].keys() == optimisers[1].state[theirs[0]].keys()


def test_float32_gives_what_bfloat16_gives(monkeypatch):
    for ours, torchs in zip(learn(monkeypatch, is_fast=False), learn(monkeypatch, is_fast=True), strict=True):
        torch.testing.assert_close(ours, torchs, atol=0.01, rtol=0)


@pytest.mark.parametrize("sides", [(30, 10), (10, 30), (16, 16)])
def test_singular_values_come_close_to_one(sides):
    torch.manual_seed(1)
    values = torch.linalg.svdvals(orthogonalised(torch.randn(sides), COEFFICIENTS, 5, 1e-7))
    assert 0.3 < values.min() <= values.max() < 1.3


def test_graphics_processors_multiply_bfloat16():
    assert multiplies_bfloat16(torch.device("cuda"))
    assert isinstance(multiplies_bfloat16(torch.device("cpu")), bool)
