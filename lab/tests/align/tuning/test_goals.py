"""Targets are shares of what another generator measures."""

import pytest

from echoavatar_lab.align.tuning.goals import GOALS, targets_like


def test_targets_are_shares_of_the_other_generators_means() -> None:
    targets = targets_like(dict.fromkeys(GOALS, 10.0))
    assert targets["music.beats"].aim == pytest.approx(9.5)
    assert targets["music.beats"].is_least
    assert not targets["rest"].is_least
    assert targets.keys() == GOALS.keys() | {"music.told_apart", "speech.told_apart"}
    assert all(target.low <= target.weight <= target.high for target in targets.values())


def test_a_generator_that_hits_less_than_chance_still_sets_a_target() -> None:
    assert targets_like(dict.fromkeys(GOALS, 10.0) | {"music.beats": -0.1})["music.beats"].aim > 0
