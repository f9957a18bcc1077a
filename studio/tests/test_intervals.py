"""Means and intervals by hand."""

import pytest
from scipy import stats

from echoavatar_studio.intervals import half_width, mean_of


def test_four_ratings_by_hand():
    """2, 1, 0, 1: mean 1, s = sqrt(2/3), t of three degrees 3.182446; half = 3.182446 * 0.816497 / 2."""
    found = mean_of([2, 1, 0, 1], [1, 1, 2, 2])
    assert found.mean == 1
    assert found.half == pytest.approx(3.182446 * 0.8164966 / 2, rel=1e-6)
    assert found.half_raters == pytest.approx(12.706205 * 0.7071068 / 2**0.5, rel=1e-6)  # raters' means 1.5 and 0.5
    assert found.count == 4


def test_scipy_says_the_same():
    values = [2, -1, 0, 0, 1, 2, 2, -2, 1]
    low, high = stats.t.interval(0.95, len(values) - 1, loc=sum(values) / 9, scale=stats.sem(values))
    assert 2 * half_width(values) == pytest.approx(high - low)


def test_one_observation_has_no_interval():
    assert half_width([1.0]) is None
    assert mean_of([1, 2], [7, 7]).half_raters is None
