"""DPO reaches a known optimum from ranked pairs, and sees every pair once a pass."""

import numpy as np
import torch
from lab.tests.align.tuning_fakes import book, dpo, policy, wants_threes

from echoavatar_lab.align.prompts import batch_of
from echoavatar_lab.training import Loop


def test_a_policy_learns_the_wanted_code_from_comparisons():
    """Two rounds of up to 24 pairs, best against worst of eight, each from the policy of the round before."""
    model = policy()
    for _ in range(2):
        stage = dpo(model=model, prompts=24, batch=12, learning_rate=3e-2)
        loop = Loop(stage)
        told = [loop.advance() for _ in range(8)]
        assert abs(told[0]["margin"]) < 1e-5  # policy and reference are the same
        assert told[-1]["accuracy"] > 0.9
        assert told[-1]["loss"] < 0.5 < told[0]["loss"]
    prompts = book().draw(99, 32)
    codes = stage.policy.rollout(batch_of(prompts), 1, torch.arange(32))
    assert wants_threes(prompts, codes).total.mean() > 0.85


def test_a_pass_sees_every_pair_once_in_an_order_of_its_own():
    stage = dpo(batch=5)
    stage._pairs = stage._pairs[:10]
    seen = [at for step in range(4) for at in stage.order(step)]
    assert sorted(seen[:10]) == sorted(seen[10:]) == list(range(10))
    assert not np.array_equal(seen[:10], seen[10:])
