import numpy as np
import pytest

from echoavatar_lab.evaluation.metrics.diversity import l1_deviation, l1_diversity


def test_a_statue_has_none_and_a_swing_its_mean_distance() -> None:
    """Two joints between -1 and 1 along two axes each: 2 joints x 2 axes x 1 m."""
    assert l1_deviation(np.ones((10, 3, 3))) == 0
    swing = np.zeros((10, 2, 3))
    swing[::2, :, :2], swing[1::2, :, :2] = 1, -1
    assert l1_deviation(swing) == pytest.approx(4)


def test_frames_of_all_clips_count_alike_and_nothing_is_overwritten() -> None:
    """30 frames at 4 m and 10 at none: 3 m."""
    swing = np.zeros((30, 2, 3))
    swing[::2, :, :2], swing[1::2, :, :2] = 1, -1
    kept = swing.copy()
    assert l1_diversity([swing, np.zeros((10, 2, 3))]) == pytest.approx(3)
    np.testing.assert_array_equal(swing, kept)
