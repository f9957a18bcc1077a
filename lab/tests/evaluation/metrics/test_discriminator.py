import math

import numpy as np
import pytest

from echoavatar_lab.evaluation.metrics.discriminator import held_out_accuracy

CLIPS = [f"clip {n // 4}" for n in range(80)]


def rows(seed: int, *, shift: float = 0.0, size: float = 1.0) -> np.ndarray:
    return shift + size * np.random.default_rng(seed).normal(size=(80, 4))


def test_sets_of_one_kind_cannot_be_told_apart() -> None:
    found = [held_out_accuracy(rows(2 * n), rows(2 * n + 1), CLIPS, CLIPS) for n in range(5)]
    assert np.mean(found) == pytest.approx(0.5, abs=0.06)


def test_another_mean_or_another_spread_is_told() -> None:
    """Stiff motion has people's mean and too little spread: the squares tell it."""
    assert held_out_accuracy(rows(0, shift=4), rows(1), CLIPS, CLIPS) > 0.98
    assert held_out_accuracy(rows(0, size=0.1), rows(1), CLIPS, CLIPS) > 0.9


def test_sides_of_unequal_size_weigh_the_same() -> None:
    found = held_out_accuracy(rows(0)[:12], rows(1), CLIPS[:12], CLIPS)
    assert found < 0.75  # always saying "captured" would be 80 of 92


def test_a_clip_that_was_learned_by_heart_does_not_count() -> None:
    """Each clip is one point far from the rest: split by window this would be perfect, split by clip it is a guess."""
    places = np.random.default_rng(0).normal(size=(40, 4))
    points = np.repeat(places, 4, 0)
    found = held_out_accuracy(points[:80], points[80:], CLIPS, CLIPS)
    assert found < 0.7


def test_one_clip_cannot_be_held_out() -> None:
    assert math.isnan(held_out_accuracy(rows(0)[:4], rows(1), CLIPS[:4], CLIPS))
