import numpy as np
import pytest

from echoavatar_lab.evaluation.metrics.physical import floor_depth_cm, foot_contact_score, jerk_m_s3


def test_jerk_of_uniform_motion_is_zero_and_of_a_cubic_its_third_derivative() -> None:
    """p = t^3 has jerk 6 m/s3; travel of the whole body does not count."""
    t = np.arange(30) / 30
    moving = np.zeros((30, 2, 3))
    moving[:, 1, 0] = 2 * t
    assert jerk_m_s3(moving) == pytest.approx(0, abs=1e-6)
    moving[:, 1, 1] = t**3
    assert jerk_m_s3(moving) == pytest.approx(6 / 2)  # one joint of two
    assert jerk_m_s3(moving + (t**3)[:, None, None]) == pytest.approx(6 / 2)
    assert np.isnan(jerk_m_s3(moving[:3]))


def test_depth_is_that_of_the_lowest_foot_below_the_floor() -> None:
    """Half of the frames 2 cm under, one foot only."""
    feet = np.zeros((10, 2, 3))
    feet[:, :, 1] = 0.05
    feet[:5, 1, 1] = -0.02
    assert floor_depth_cm(feet) == pytest.approx(1.0)


def test_a_root_that_accelerates_while_both_feet_slide_is_punished() -> None:
    t = np.arange(60) / 30
    body = np.zeros((60, 12, 3))
    body[:, 0, 0] = np.sin(3 * t)
    assert foot_contact_score(body) == 0
    body[:, [7, 10], 0] = t[:, None]
    assert foot_contact_score(body) == 0  # the right foot still stands
    body[:, [8, 11], 2] = t[:, None]
    assert foot_contact_score(body) > 1
