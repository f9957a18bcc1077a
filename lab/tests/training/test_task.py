from typing import NamedTuple

import torch
from lab.tests.training.line import Line
from torch import Tensor, nn

from echoavatar_lab.training import TrainingConfig, adamw
from echoavatar_lab.training.task import row_count, take_rows, tensors_in


class Pair(NamedTuple):
    a: Tensor
    b: tuple[Tensor, None, str]


BATCH = Pair(torch.arange(6), (torch.arange(12).view(6, 2), None, "kept"))


def test_rows_are_cut_from_every_tensor_and_the_rest_stays():
    piece = take_rows(BATCH, slice(2, 4), torch.device("cpu"))
    assert isinstance(piece, Pair)
    assert piece.a.tolist() == [2, 3]
    assert piece.b[0].tolist() == [[4, 5], [6, 7]]
    assert piece.b[1:] == (None, "kept")


def test_a_batch_has_as_many_rows_as_its_first_tensor():
    assert row_count(BATCH) == 6
    assert len(list(tensors_in(BATCH))) == 2
    assert Line().weight(BATCH) == 6.0


def test_matrices_decay_and_the_rest_does_not_unless_asked():
    model, config = nn.Sequential(nn.Linear(2, 3), nn.LayerNorm(3)), TrainingConfig(weight_decay=0.2)
    model[1].bias.requires_grad_(False)
    groups = adamw([model], config).param_groups
    assert [(len(group["params"]), group["weight_decay"]) for group in groups] == [(1, 0.2), (2, 0.0)]
    groups = adamw([model], config, decays_vectors=True, but=[model[0].weight]).param_groups
    assert [(len(group["params"]), group["weight_decay"]) for group in groups] == [(2, 0.2)]
    assert groups[0]["betas"] == config.betas
    assert isinstance(adamw([model], config), torch.optim.AdamW)
