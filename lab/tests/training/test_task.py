from typing import NamedTuple

import pytest
import torch
from lab.tests.training.line import Line
from torch import Tensor, nn

from echoavatar_lab.training import TrainingConfig, adamw
from echoavatar_lab.training.task import row_count, take_rows, tensors_in


def test_the_rate_warms_up_then_follows_its_schedule():
    """Peak 1, two steps of warm-up: a half, then the whole; then what each schedule says half-way of ten steps."""
    base = TrainingConfig(steps=10, learning_rate=1.0, warmup=2, final_rate=0.1)
    assert base.rate_at(0) == pytest.approx(0.5)
    assert base.rate_at(5) == pytest.approx(0.55)  # 0.1 + 0.9 / 2
    assert base.rate_at(10) == pytest.approx(0.1)
    constant = base.model_copy(update={"schedule": "constant"})
    assert [constant.rate_at(step) for step in (1, 5, 10)] == [1, 1, 1]
    drops = base.model_copy(update={"schedule": "step", "decay_at": (0.5, 0.8), "decay_factor": 0.1})
    assert [drops.rate_at(step) for step in (1, 4, 5, 8)] == pytest.approx([1, 1, 0.1, 0.01])


def test_the_clock_may_say_how_much_is_done():
    config = TrainingConfig(steps=1000, learning_rate=1.0, warmup=0, final_rate=0.0)
    assert config.rate_at(1, done=0.5) == pytest.approx(0.5)


def test_noise_is_of_seed_step_and_salt_alone():
    config = TrainingConfig(seed=3)

    def drawn(*args):
        return torch.rand(4, generator=config.noise(*args)).tolist()

    assert drawn(7) == drawn(7)
    assert drawn(7) != drawn(8) != drawn(7, 500_009)


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
