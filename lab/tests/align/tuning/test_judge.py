"""What continuations earn follows what they do and what is short of its target."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.align.tuning_fakes import clips

from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.align.prompts import Prompt, PromptSampler
from echoavatar_lab.align.tuning.goals import GOALS, targets_like
from echoavatar_lab.align.tuning.judge import TargetJudge, kind_of, means_of, measured

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
    assert [kind_of(prompt) for prompt in prompts] == ["music", "speech", ""]


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
    kinds = [kind for prompt in prompts for kind in [kind_of(prompt)] * GROUP]
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
    kinds = [kind for prompt in prompts for kind in [kind_of(prompt)] * GROUP]
    less = judge._by_frame(found._replace(still=still), kinds) - judge._by_frame(
        found._replace(still=torch.zeros_like(still)), kinds
    )
    assert (less[:GROUP, 40:50] < 0).all()
    assert not less[GROUP:].any()
    assert not less[:, :40].any()
    assert not less[:, 50:].any()


def test_means_are_those_of_rows_of_one_kind(judge: TargetJudge, prompts: list[Prompt], codes: torch.Tensor) -> None:
    found = measured(judge.tokenizer, prompts, codes)
    means = means_of(found, ["music"] * GROUP + ["speech"] * GROUP + [""] * GROUP)
    assert means["music.jerk"] == pytest.approx(float(found.jerk[:3].mean()), rel=1e-5)
    assert means["speech.stresses"] == pytest.approx(float(found.stresses[3:6].sum(1).mean()), rel=1e-5)
