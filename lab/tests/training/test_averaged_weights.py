import torch
from torch import nn

from echoavatar_lab.training.averaged_weights import AveragedWeights


def test_the_average_follows_slowly_and_knows_only_what_learns():
    """A weight that jumps from 0 to 1: the first steps go 9/10, 9/11 of what is left, later ones 1 - decay."""
    model = nn.Linear(1, 1)
    model.bias.requires_grad_(False)
    nn.init.zeros_(model.weight)
    average = AveragedWeights({"m": model}, 0.99)
    assert list(average.values) == ["m.weight"]
    nn.init.ones_(model.weight)
    average.update(0)
    torch.testing.assert_close(average.values["m.weight"], torch.tensor([[0.9]]))
    nn.init.zeros_(model.weight)
    average.update(10**6)
    torch.testing.assert_close(average.values["m.weight"], torch.tensor([[0.9 * 0.99]]))


def test_modules_hold_the_average_inside_the_context_only():
    model = nn.Linear(2, 2)
    average, own = AveragedWeights({"m": model}, 0.99), model.weight.detach().clone()
    average.values["m.weight"] += 1
    with average.applied():
        torch.testing.assert_close(model.weight, own + 1)
    torch.testing.assert_close(model.weight, own)
