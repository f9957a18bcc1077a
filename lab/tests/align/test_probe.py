"""Measurements repeat, splitting into pieces changes nothing, and motion metrics are reported with the rewards."""

import pytest
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import book, clips, policy, wants_threes

from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.align import probe as room
from echoavatar_lab.align.judge import DecodingJudge
from echoavatar_lab.align.motion_metrics import MotionMetrics
from echoavatar_lab.align.policy import GeneratorPolicy
from echoavatar_lab.align.probe import Probe
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.rewards import RewardMix
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped


def test_the_reward_is_that_of_the_continuations_and_pieces_change_nothing(monkeypatch):
    one, prompts = GeneratorPolicy(policy()), book().spread(5)
    found = Probe(prompts, wants_threes, group=3)(one, one)
    assert found["kl"] == pytest.approx(0, abs=1e-6)
    assert found["reward"] == found["rewards"]["threes"]
    assert sum(found["by_prompt"]) / 5 == pytest.approx(found["reward"][0], abs=1e-4)
    assert 0.02 < found["reward"][0] < 0.3  # an eighth by chance
    monkeypatch.setattr(room, "TOGETHER", 2)
    again = Probe(prompts, wants_threes, group=3)(one, one)
    assert again["by_prompt"] == found["by_prompt"]
    other = Probe(prompts, wants_threes, group=3, seed=1)(one, one)
    assert other["by_prompt"] != found["by_prompt"]


def test_motion_metrics_are_reported_with_the_rewards(tiny_bundle):
    bundle = load_bundle(tiny_bundle)
    prompts = PromptSampler(clips(3, chunks=8), past=2, length=4).spread(3)
    judge = DecodingJudge(bundle.tokenizer, RewardMix({"smoothness": 1.0}, reference_statistics()))
    motion_metrics = MotionMetrics(bundle.tokenizer, prompts, load_shipped(), reference_statistics())
    one = GeneratorPolicy(bundle.generator)
    found = Probe(prompts, judge, group=2, motion_metrics=motion_metrics)(one, one)
    plain = Probe(prompts, judge, group=2)(one, one)
    assert found["by_prompt"] == plain["by_prompt"]
    assert found["fid"] > 0
    assert "fid" not in plain
