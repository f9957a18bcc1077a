import numpy as np
import pytest
import torch

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.metrics.positions import (
    floor_depth_cm,
    foot_contact_score,
    heading,
    jerk_m_s3,
    l1_deviation,
    mean_distance,
    reconstruction,
    without_heading,
)
from echoavatar_lab.kinematics import matrix_from_axis_angle


def test_heading_is_the_yaw_that_is_taken_out() -> None:
    turned = matrix_from_axis_angle(torch.tensor([[[0.0, 1.2, 0.0], [0.3, 0.0, 0.0]]]))
    assert float(heading(turned[:, 0])) == pytest.approx(1.2)
    facing = without_heading(turned)
    torch.testing.assert_close(facing[:, 0], torch.eye(3)[None])
    torch.testing.assert_close(facing[:, 1], turned[:, 1])


def test_a_bow_is_kept_when_heading_goes() -> None:
    """Turned by 2 rad, then bent by 0.4 about its own side: the bend stays."""
    turn, bow = (matrix_from_axis_angle(torch.tensor([v])) for v in ([0.0, 2.0, 0.0], [0.4, 0.0, 0.0]))
    torch.testing.assert_close(without_heading((turn @ bow)[:, None])[:, 0], bow, atol=1e-6, rtol=0)


def test_errors_are_means_of_lengths() -> None:
    """One joint of two is 5 cm off."""
    true = torch.zeros(4, 2, 3)
    made = true.clone()
    made[:, 0] = torch.tensor([0.03, 0.0, 0.04])
    assert mean_distance(made, true) == pytest.approx(0.025)


def test_the_root_is_measured_by_the_length_of_its_error() -> None:
    made = torch.tensor([[0.003, 0.004]])
    assert mean_distance(made, torch.zeros(1, 2)) == pytest.approx(0.005)


def still(frames: int = 4) -> torch.Tensor:
    return torch.eye(3).expand(frames, HUMANOID.joints, 3, 3).clone()


def test_turning_the_whole_body_is_no_pose_error() -> None:
    turned = still()
    turned[:, 0] = matrix_from_axis_angle(torch.tensor([0.0, 1.2, 0.0]))
    result = reconstruction(HUMANOID, still(), turned, torch.zeros(4, 2), torch.zeros(4, 2))
    assert result.mpjpe_body_mm == pytest.approx(0, abs=1e-3)


def test_a_turned_wrist_moves_no_body_joint_and_counts_for_the_fingers() -> None:
    """Both wrists turned: 22 body joints stay, all 30 finger joints move."""
    turned = still()
    for side in ("left", "right"):
        turned[:, HUMANOID.index(f"{side}Hand")] = matrix_from_axis_angle(torch.tensor([0.5, 0.0, 0.0]))
    result = reconstruction(HUMANOID, still(), turned, torch.zeros(4, 2), torch.zeros(4, 2))
    assert result.mpjpe_body_mm == pytest.approx(0, abs=1e-3)
    assert result.mpjpe_hands_mm > 5


def test_velocity_error_is_the_length_of_the_difference() -> None:
    """(3, 4) mm a frame off is 5 mm."""
    off = torch.tensor([[0.003, 0.004]]).expand(4, 2)
    assert reconstruction(HUMANOID, still(), still(), torch.zeros(4, 2), off).root_velocity_mm == pytest.approx(5)


def test_a_statue_has_none_and_a_swing_its_mean_distance() -> None:
    """Two joints between -1 and 1 along two axes each: 2 joints x 2 axes x 1 m."""
    assert l1_deviation(np.ones((10, 3, 3))) == 0
    swing = np.zeros((10, 2, 3))
    swing[::2, :, :2], swing[1::2, :, :2] = 1, -1
    assert l1_deviation(swing) == pytest.approx(4)


def test_diversity_overwrites_nothing() -> None:
    swing = np.zeros((30, 2, 3))
    swing[::2, :, :2], swing[1::2, :, :2] = 1, -1
    kept = swing.copy()
    l1_deviation(swing)
    np.testing.assert_array_equal(swing, kept)


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


SMPL_FEET = (7, 10, 8, 11)


def test_a_root_that_accelerates_while_both_feet_slide_is_punished() -> None:
    t = np.arange(60) / 30
    body = np.zeros((60, 12, 3))
    body[:, 0, 0] = np.sin(3 * t)
    assert foot_contact_score(body, SMPL_FEET) == 0
    body[:, [7, 10], 0] = t[:, None]
    assert foot_contact_score(body, SMPL_FEET) == 0  # the right foot still stands
    body[:, [8, 11], 2] = t[:, None]
    assert foot_contact_score(body, SMPL_FEET) > 1
