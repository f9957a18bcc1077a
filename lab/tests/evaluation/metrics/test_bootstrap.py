import numpy as np
import pytest

from echoavatar_lab.evaluation.metrics.bootstrap import interval, mean_interval


def test_an_interval_of_a_mean_is_about_two_standard_errors_wide() -> None:
    """400 numbers of spread 1: the mean is known to 1.96 / 20."""
    values = np.random.default_rng(0).normal(5, 1, 400)
    low, high = mean_interval(values)
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.12)


def test_it_holds_the_truth_nineteen_times_in_twenty() -> None:
    random = np.random.default_rng(1)
    held = 0
    for seed in range(200):
        low, high = mean_interval(random.normal(0, 1, 40), samples=400, seed=seed)
        held += low < 0 < high
    assert 0.89 < held / 200 < 0.99


def test_the_same_seed_gives_the_same_interval() -> None:
    values = np.arange(10.0)
    assert mean_interval(values, seed=3) == mean_interval(values, seed=3)
    assert mean_interval(values, seed=3) != mean_interval(values, seed=4)


def test_weights_count_and_clips_without_a_value_do_not() -> None:
    values, weights = np.array([0.0, 1.0, np.nan]), np.array([1e9, 1.0, 5.0])
    low, high = mean_interval(values, weights)
    assert low == 0
    assert high == 1  # a quarter of the resamples hold the second clip alone


def test_one_clip_has_no_interval() -> None:
    assert np.isnan(mean_interval(np.array([1.0]))).all()
    assert np.isnan(interval(lambda clips: 1.0, 1)).all()


def test_a_distance_is_centred_where_the_plain_interval_would_miss_it() -> None:
    """Distance of a sample's mean from zero: resamples scatter, so their distances are larger on the whole."""
    values = np.random.default_rng(0).normal(0, 1, (30, 200))

    def distance(clips: np.ndarray) -> float:
        return float((values[clips].mean(0) ** 2).sum())

    own = distance(np.arange(30))
    plain, centred = interval(distance, 30), interval(distance, 30, is_centred=True)
    assert plain.low > own
    assert centred.low < own < centred.high
