import numpy as np
import pytest

from echoavatar_lab.evaluation.metrics.beat_alignment import hit_rate, mean_hit_rate, overlapping


def test_score_follows_the_formula() -> None:
    """One event, one beat a sigma away: exp(-1/2); a second event on the beat: the mean."""
    assert hit_rate(np.array([1.0]), np.array([1.06]), 0.06) == pytest.approx(np.exp(-0.5))
    assert hit_rate(np.array([1.0, 1.06]), np.array([1.06]), 0.06) == pytest.approx((1 + np.exp(-0.5)) / 2)


def test_the_nearest_beat_counts_and_only_events_ask() -> None:
    """A second beat far from everything changes nothing; a second event would."""
    assert hit_rate(np.array([1.0]), np.array([1.0, 9.0]), 0.06) == 1
    assert hit_rate(np.array([1.0, 9.0]), np.array([1.0]), 0.06) == pytest.approx(0.5)


def test_no_motion_scores_zero_and_no_events_score_nothing() -> None:
    assert hit_rate(np.array([1.0]), np.zeros(0), 0.06) == 0
    assert np.isnan(hit_rate(np.zeros(0), np.array([1.0]), 0.06))


def test_a_joint_that_never_rests_pulls_the_mean_down() -> None:
    assert mean_hit_rate(np.array([1.0]), [np.array([1.0]), np.zeros(0)], 0.06) == 0.5


def test_other_clips_events_count_only_where_ours_lie() -> None:
    ours = np.array([2.0, 5.0])
    assert overlapping(np.array([1.0, 2.0, 3.0, 6.0]), ours).tolist() == [2.0, 3.0]
    assert overlapping(ours, np.zeros(0)).tolist() == []
