"""Pairs: written, read back, ranked, refused by line."""

import numpy as np
import pytest
import torch
from lab.tests.align.tuning_fakes import book, dpo, policy, wants_threes
from tests.models.generator.tiny import LAYOUT

from echoavatar.errors import MotionError
from echoavatar_lab.align.dpo import rank_pairs, read_pairs, write_pairs
from echoavatar_lab.align.policy import GeneratorPolicy, continuations
from echoavatar_lab.align.prompts import batch_of
from echoavatar_lab.training import Loop


def ranked(margin: float = 0.0):
    (drawn, codes), *_ = continuations(GeneratorPolicy(policy()), book(), prompts=6, group=8, seed=0)
    return rank_pairs(drawn, codes, wants_threes, past=1, margin=margin)


def test_the_best_is_chosen_over_the_worst_and_small_differences_are_left_out():
    pairs = ranked()
    for pair in pairs:
        better, worse = (np.mean(np.array(codes) == 3) for codes in (pair.chosen, pair.rejected))
        assert better - worse == pytest.approx(pair.margin)
    margins = sorted(pair.margin for pair in pairs)
    assert len(ranked(margin=margins[3] - 1e-9)) == sum(m >= margins[3] - 1e-9 for m in margins)


def test_files_come_back(tmp_path):
    pairs = ranked()
    assert write_pairs(tmp_path / "pairs.jsonl", pairs) == len(pairs)
    found = read_pairs(tmp_path / "pairs.jsonl", book(), LAYOUT)
    assert [pair for _, pair in found] == pairs
    assert [(prompt.clip, prompt.start) for prompt, _ in found] == [(pair.clip, pair.start) for pair in pairs]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"clip": "missing"}, "line 2: no clip 'missing'"),
        ({"start": 9}, "line 2: clip 'clip. has 6 chunks"),
        ({"past": 2}, "line 2: the prompt has 2 chunks of past, this run has 1; pass --past 2"),
        ({"chosen": (((0, 0),) * 3,)}, r"line 2: chosen has shape \(1, 3, 2\), expected \(2, 3, 2\)"),
        ({"rejected": (((0, 8),) * 3,) * 2}, r"line 2: rejected holds codes outside 0\.\.7"),
    ],
)
def test_lines_that_do_not_fit_are_named(tmp_path, changes, message):
    good = ranked()[0]
    write_pairs(tmp_path / "pairs.jsonl", [good, good.model_copy(update=changes)])
    with pytest.raises(MotionError, match=message.replace("'clip. ", "'clip\\d' ")):
        read_pairs(tmp_path / "pairs.jsonl", book(), LAYOUT)


def test_damaged_files_are_named(tmp_path):
    with pytest.raises(MotionError, match="cannot be read"):
        read_pairs(tmp_path / "none.jsonl", book(), LAYOUT)
    (tmp_path / "bad.jsonl").write_text("{not json\n")
    with pytest.raises(MotionError, match="line 1: not a pair"):
        read_pairs(tmp_path / "bad.jsonl", book(), LAYOUT)
    write_pairs(tmp_path / "few.jsonl", ranked()[:1])
    with pytest.raises(MotionError, match="no pair with a margin of at least 2"):
        read_pairs(tmp_path / "few.jsonl", book(), LAYOUT, margin=2.0)


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
