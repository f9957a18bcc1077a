"""Recipes are valid for every method, and the paper's has the paper's numbers."""

import pytest
from pydantic import ValidationError

from echoavatar_lab.align.config import AlignTraining, recipe


@pytest.mark.parametrize("name", ["tiny", "rehearsal", "paper"])
@pytest.mark.parametrize("method", ["grpo", "dpo", "ppo"])
def test_every_recipe_fits_every_method(name, method):
    assert recipe(name, method).method == method


def test_the_papers_numbers():
    """Settings: batch 16, rate 6e-5, KL 0.01, 30 rollouts (PPO 1), DPO's beta 0.1, critic 1e-5."""
    grpo, ppo = recipe("paper", "grpo"), recipe("paper", "ppo")
    assert (grpo.batch, grpo.learning_rate, grpo.kl_weight, grpo.group) == (16, 6e-5, 0.01, 30)
    assert (grpo.credit, grpo.beta, grpo.length) == ("sequence", 0.1, 15)
    assert (ppo.group, ppo.critic_rate) == (1, 1e-5)


def test_a_group_of_one_is_refused():
    with pytest.raises(ValidationError, match="group must be at least 2"):
        AlignTraining(method="grpo", group=1)
    with pytest.raises(ValueError, match="no recipe 'huge'"):
        recipe("huge", "grpo")
