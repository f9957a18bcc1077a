"""GRPO reaches a known optimum."""

import pytest
import torch
from lab.tests.align.tuning_fakes import grpo

from echoavatar.errors import CheckpointError
from echoavatar_lab.training import Loop


@pytest.mark.parametrize("credit", [pytest.param("sequence", marks=pytest.mark.slow), "to_go"])
def test_a_policy_learns_the_wanted_code(credit):
    """An eighth of the codes to begin with, over nine tenths after 320 continuations."""
    loop = Loop(grpo(credit=credit))
    rewards = [loop.advance()["reward"] for _ in range(20)]
    assert rewards[0] < 0.3
    assert rewards[-1] > 0.9


@pytest.mark.slow
def test_several_steps_on_the_same_continuations_learn_more_from_them():
    curves = []
    for epochs in (1, 3):
        loop = Loop(grpo(epochs=epochs, learning_rate=1e-2))
        curves.append([loop.advance()["reward"] for _ in range(8 * epochs)][::epochs])
    assert curves[0][0] == curves[1][0]
    assert sum(curves[1]) > sum(curves[0]) + 0.3


def test_rewards_reach_only_the_layers_that_they_are_credited_to():
    advantages = torch.tensor([[1.0, -2.0]])
    task = grpo(layers=1)
    layers, parts = task.policy.layout.motion_layers, task.policy.layout.parts
    credited = task.credited(advantages).view(1, 2, parts, layers)
    torch.testing.assert_close(credited[..., 0], advantages[..., None].expand(1, 2, parts))
    assert layers > 1
    assert (credited[..., 1:] == 0).all()
    assert (grpo().credited(advantages) == advantages[..., None]).all()


def test_more_layers_than_the_generator_has_are_refused():
    with pytest.raises(CheckpointError, match="layers is 9, the generator has"):
        grpo(layers=9)
