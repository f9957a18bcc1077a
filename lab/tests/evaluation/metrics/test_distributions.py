import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import sqrtm

from echoavatar.errors import MotionError
from echoavatar_lab.evaluation.metrics.distributions import (
    frechet_between,
    frechet_distance,
    held_out_accuracy,
    moments,
    pooled,
)

RANDOM = np.random.default_rng(0)


def test_a_shift_costs_its_square_and_a_stretch_the_square_of_its_difference() -> None:
    """Unit spread moved by (3, 4): 25. Along one axis spread 1 against 3: (3 - 1)^2 = 4."""
    values = RANDOM.normal(size=(500, 2))
    assert frechet_distance(values + [3, 4], values) == pytest.approx(25)
    line = values[:, :1] / values[:, :1].std(ddof=1)
    assert frechet_distance(3 * (line - line.mean()), line - line.mean()) == pytest.approx(4)


def test_it_equals_the_textbook_form_with_a_matrix_root() -> None:
    a, b = RANDOM.normal(size=(90, 7)) @ RANDOM.normal(size=(7, 7)), RANDOM.normal(size=(80, 7))
    one, two = (np.cov(x, rowvar=False) for x in (a, b))
    textbook = ((a.mean(0) - b.mean(0)) ** 2).sum() + np.trace(one + two - 2 * np.real(sqrtm(one @ two)))
    assert frechet_distance(a, b) == pytest.approx(textbook, rel=1e-10)
    assert frechet_distance(a, b) == pytest.approx(frechet_distance(b, a), rel=1e-10)


@given(cuts=st.lists(st.integers(0, 12), min_size=1, max_size=6))
def test_moments_of_clips_add_up_to_those_of_the_whole(cuts: list[int]) -> None:
    values = np.random.default_rng(len(cuts)).normal(size=(sum(cuts) + 3, 4))
    parts = np.split(values, np.cumsum(cuts))
    whole, joined = moments(values), pooled([moments(part) for part in parts])
    assert whole.rows == joined.rows
    np.testing.assert_allclose(joined.mean, whole.mean, atol=1e-12)
    np.testing.assert_allclose(joined.covariance, np.cov(values, rowvar=False), atol=1e-12)


def test_fewer_samples_than_features_is_no_trouble() -> None:
    values = RANDOM.normal(size=(5, 30))
    assert frechet_distance(values, values) == pytest.approx(0, abs=1e-5)


def test_invalid_features_are_refused() -> None:
    with pytest.raises(MotionError, match="not finite"):
        moments(np.array([[np.nan, 1.0]]))
    with pytest.raises(MotionError, match="longer clips"):
        frechet_between(moments(np.ones((1, 2))), moments(np.ones((5, 2))))


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
