"""DPO reaches a known optimum from ranked pairs, and sees every pair once a pass."""

import copy

import numpy as np
import torch
from tests.align.tuning import book, policy, training, wants_threes

from echoavatar.align.dpo import DpoTrainer
from echoavatar.align.policy import GeneratorPolicy
from echoavatar.align.preferences import rank
from echoavatar.align.prompts import batch_of


def compared(prompts: int = 24, model=None):
    mine = book()
    asked = [prompt for number in range(prompts) for prompt in mine.draw(number, 1)]
    pairs = rank(GeneratorPolicy(model or policy()), asked, wants_threes, past=1, group=8)
    return [(mine.cut(pair.clip, pair.start), pair) for pair in pairs]


def test_a_policy_learns_from_comparisons_to_say_the_wanted_code():
    """Two rounds of up to 24 pairs, best against worst of eight, each from the policy of the round before."""
    model, settings = policy(), training("dpo", batch=12, learning_rate=3e-2)
    for _ in range(2):
        trainer = DpoTrainer(model, copy.deepcopy(model), settings, wants_threes, pairs=compared(model=model))
        told = [trainer.step() for _ in range(8)]
        assert told[0]["accuracy"] == 0.0  # policy and reference are the same: no margin yet
        assert told[-1]["accuracy"] > 0.9
        assert told[-1]["loss"] < 0.5 < told[0]["loss"]
    prompts = book().draw(99, 32)
    codes = trainer.policy.rollout(batch_of(prompts), 1, torch.arange(32))
    assert wants_threes(prompts, codes).total.mean() > 0.85


def test_a_pass_sees_every_pair_once_in_an_order_of_its_own():
    trainer = DpoTrainer(policy(), policy(), training("dpo", batch=5), wants_threes, pairs=compared(12)[:10])
    seen = []
    for step in range(4):
        trainer.next_step = step
        seen += trainer._order()
    assert sorted(seen[:10]) == sorted(seen[10:]) == list(range(10))
    assert not np.array_equal(seen[:10], seen[10:])
