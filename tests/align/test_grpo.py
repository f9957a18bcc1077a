"""GRPO reaches a known optimum."""

import pytest
from tests.align.tuning import book, policy, training, wants_threes

from echoavatar.align.grpo import GrpoTrainer


@pytest.mark.parametrize("credit", [pytest.param("sequence", marks=pytest.mark.slow), "to_go"])
def test_a_policy_learns_to_say_the_wanted_code_everywhere(credit):
    """An eighth of the codes to begin with, over nine tenths after 320 continuations."""
    trainer = GrpoTrainer(policy(), policy(), training("grpo", credit=credit), wants_threes, book=book())
    rewards = [trainer.step()["reward"] for _ in range(20)]
    assert rewards[0] < 0.3
    assert rewards[-1] > 0.9


@pytest.mark.slow
def test_several_passes_learn_faster_from_the_same_continuations():
    curves = []
    for epochs in (1, 3):
        settings = training("grpo", epochs=epochs, learning_rate=1e-2)
        trainer = GrpoTrainer(policy(), policy(), settings, wants_threes, book=book())
        curves.append([trainer.step()["reward"] for _ in range(8)])
    assert curves[0][0] == curves[1][0]
    assert sum(curves[1]) > sum(curves[0]) + 0.3
