"""Weights follow their targets."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.align.tuning_fakes import clips

from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.align.prompts import Prompt, PromptSampler
from echoavatar_lab.align.targets import (
    GOALS,
    Opponent,
    Target,
    TargetJudge,
    Weights,
    kinds_of,
    means_of,
    measured,
    targets_like,
)

LEAST = Target(aim=10, weight=1, low=0.5, high=2)
MOST = LEAST.model_copy(update={"is_least": False})


@pytest.mark.parametrize(
    ("target", "mean", "grows"), [(LEAST, 8, True), (LEAST, 12, False), (MOST, 12, True), (MOST, 8, False)]
)
def test_a_weight_grows_while_its_mean_is_short(target: Target, mean: float, grows: bool) -> None:
    weights = Weights({"turn": target})
    weights.see("turn", mean)
    assert (weights.values["turn"] > 1) is grows
    for _ in range(200):
        weights.see("turn", mean)
    assert weights.values["turn"] == (2 if grows else 0.5)  # its bounds


def test_a_mean_that_is_not_finite_changes_nothing() -> None:
    weights = Weights({"turn": LEAST})
    weights.see("turn", float("nan"))
    assert weights.values["turn"] == 1
    assert not weights.means


def test_targets_are_shares_of_the_other_generators_means() -> None:
    targets = targets_like(dict.fromkeys(GOALS, 10.0))
    assert targets["music.beats"].aim == pytest.approx(9.5)
    assert targets["music.beats"].is_least
    assert not targets["rest"].is_least
    assert targets.keys() == GOALS.keys() | {"music.told_apart", "speech.told_apart"}
    assert all(target.low <= target.weight <= target.high for target in targets.values())


def test_a_generator_that_hits_less_than_chance_still_sets_a_target() -> None:
    assert targets_like(dict.fromkeys(GOALS, 10.0) | {"music.beats": -0.1})["music.beats"].aim > 0


def test_the_opponent_follows_the_policy() -> None:
    random = np.random.default_rng(0)

    def windows(middle: float) -> np.ndarray:
        return middle + random.standard_normal((200, 9))

    opponent = Opponent(windows(0.0))
    assert opponent.see(windows(2.0)) is None  # nothing learnt yet
    assert opponent.see(windows(2.0)) > 0.95
    assert opponent.odds(windows(2.0)).mean() < -2 < 2 < opponent.odds(windows(0.0)).mean()
    assert np.abs(opponent.odds(windows(50.0))).max() <= 4
    for _ in range(12):
        last = opponent.see(windows(0.0))
    assert last < 0.65  # the policy moves as people do now


def test_it_goes_on_where_its_state_was_taken() -> None:
    random = np.random.default_rng(0)
    batches, people = random.standard_normal((5, 40, 9)), random.standard_normal((40, 9)) + 1
    first, second = Opponent(people), Opponent(people)
    for batch in batches[:4]:
        first.see(batch)
    second.load_state(first.state())
    assert second.see(batches[4]) == first.see(batches[4])
    np.testing.assert_array_equal(second.odds(people), first.odds(people))
    assert first.odds(people).any()


GROUP = 3


@pytest.fixture
def prompts() -> list[Prompt]:
    """Music, speech, and both in one."""
    drawn = PromptSampler(clips(2, 40), past=6, length=28).draw(0, 3)
    both = np.repeat([1, 2], 28)
    domains = (np.full(56, 2), np.full(56, 1), both)
    return [replace(prompt, domain=domain) for prompt, domain in zip(drawn, domains, strict=True)]


@pytest.fixture
def codes() -> torch.Tensor:
    return torch.randint(8, (3 * GROUP, 56, 3, 2), generator=torch.Generator().manual_seed(0))


@pytest.fixture
def judge(tiny_bundle: Path) -> TargetJudge:
    people = np.random.default_rng(0).uniform(0, 1, (30, 9))
    means = dict.fromkeys(GOALS, 1.0)
    return TargetJudge(load_bundle(tiny_bundle).tokenizer, {"music": people, "speech": people}, targets_like(means))


def test_the_kind_is_that_of_nearly_all_of_the_sound(prompts: list[Prompt]) -> None:
    assert kinds_of(prompts).tolist() == ["music", "speech", ""]


def test_rewards_have_the_shape_of_the_continuations(
    judge: TargetJudge, prompts: list[Prompt], codes: torch.Tensor
) -> None:
    found = judge(prompts, codes)
    assert found.tokens.shape == (9, 56)
    assert found.whole.shape == (9,)
    assert np.isfinite(found.total).all()
    assert {"music.jerk", "speech.room", "rest", "weight.music.beats"} <= judge.told.keys()


def test_a_statistic_pays_by_its_weight_and_only_in_its_kind_of_sound(
    judge: TargetJudge, prompts: list[Prompt], codes: torch.Tensor
) -> None:
    found = measured(judge.tokenizer, prompts, codes)
    kinds = kinds_of(prompts).repeat(GROUP)
    before = judge._by_target(found, kinds)
    judge.weights.values["speech.trunk_lean"] += 1.0
    more = judge._by_target(found, kinds) - before
    assert not more[:3].any()
    assert (more[3:6] > 0).all()
    assert not more[6:].any()


def test_still_hands_in_music_cost_in_their_frames(
    judge: TargetJudge, prompts: list[Prompt], codes: torch.Tensor
) -> None:
    found = measured(judge.tokenizer, prompts, codes)
    still = torch.zeros_like(found.still)
    still[:, 40:50] = True
    kinds = kinds_of(prompts).repeat(GROUP)
    less = judge._by_frame(found._replace(still=still), kinds) - judge._by_frame(
        found._replace(still=torch.zeros_like(still)), kinds
    )
    assert (less[:GROUP, 40:50] < 0).all()
    assert not less[GROUP:].any()
    assert not less[:, :40].any()
    assert not less[:, 50:].any()


def test_means_are_those_of_rows_of_one_kind(judge: TargetJudge, prompts: list[Prompt], codes: torch.Tensor) -> None:
    found = measured(judge.tokenizer, prompts, codes)
    means = means_of(found, kinds_of(prompts).repeat(GROUP))
    assert means["music.jerk"] == pytest.approx(float(found.jerk[:3].mean()), rel=1e-5)
    assert means["speech.stresses"] == pytest.approx(float(found.stresses[3:6].sum(1).mean()), rel=1e-5)
