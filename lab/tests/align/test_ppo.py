"""PPO reaches a known optimum, with one continuation a prompt."""

import pytest
from lab.tests.align.tuning_fakes import ppo

from echoavatar_lab.training import Loop


@pytest.mark.slow
def test_policy_and_critic_learn_the_wanted_code():
    """Returns come near 1 and 0.5 at the two tokens: a critic that still said 0 would be off by 0.31."""
    sizes = {"group": 1, "batch": 16, "discount": 1.0, "epochs": 2, "learning_rate": 2e-2, "critic_rate": 5e-2}
    loop = Loop(ppo(**sizes))
    told = [loop.advance() for _ in range(36)]
    assert told[0]["reward"] < 0.3
    assert told[-1]["reward"] > 0.9
    assert told[-1]["value"] < 0.1


def test_the_critic_has_a_rate_of_its_own():
    one = ppo(learning_rate=1e-2, critic_rate=1e-3, warmup=0)
    loop = Loop(one)
    loop.advance()
    assert [group["lr"] for optimiser in loop.optimisers for group in optimiser.param_groups] == pytest.approx(
        [1e-2] * (len(loop.optimisers[0].param_groups)) + [1e-3] * len(loop.optimisers[1].param_groups)
    )
