import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying
from tests.motion.kinematics.test_foot_planting import standing

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.data.statistics import describe, wrist_speeds


def test_a_statue_rests():
    numbers = describe(standing(30))
    for name in ("wrist_speed_mean_m_s", "leg_energy_m2_s2", "joint_speed_max_deg_s", "skate_cm_s"):
        assert numbers[name] == pytest.approx(0, abs=1e-3)
    assert numbers["pause_ratio"] == 1
    assert numbers["reach_ratio_mean"] == pytest.approx(1, abs=1e-3)


def test_walking_is_not_gesturing():
    numbers = describe(standing(60, drift=0.5))
    assert numbers["wrist_speed_mean_m_s"] == pytest.approx(0, abs=1e-3)
    assert numbers["leg_energy_m2_s2"] == pytest.approx(0.25, rel=1e-3)
    assert numbers["skate_cm_s"] == pytest.approx(50, rel=1e-3)


def test_a_waving_arm_is_measured():
    """A straight arm turned about the vertical at 1 rad/s moves the wrist at its length in m/s."""
    motion = standing(30)
    turns = motion.rotations.copy()
    half = -np.arange(30) / 30 / 2
    turns[:, HUMANOID.index("leftUpperArm")] = np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], -1)
    moving = Motion(HUMANOID, turns, motion.root, 30)
    speeds = wrist_speeds(moving)
    np.testing.assert_allclose(speeds[:, 0], 0.265 + 0.245, rtol=1e-3)
    np.testing.assert_allclose(speeds[:, 1], 0, atol=1e-3)
    numbers = describe(moving)
    assert numbers["joint_speed_max_deg_s"] == pytest.approx(np.degrees(1), rel=1e-3)
    assert numbers["pause_ratio"] == 0


def test_every_number_is_finite_and_named_with_its_unit():
    numbers = describe(swaying(40))
    assert all(np.isfinite(list(numbers.values())))
    assert {"finger_speed_mean_deg_s", "head_speed_mean_deg_s", "body_jerk_mean_m_s3", "stroke_rate_hz"} <= set(numbers)


def test_too_few_frames_are_refused():
    with pytest.raises(ValueError, match="four frames"):
        describe(standing(3))


def test_feet_that_point_aside_are_counted():
    motion = standing(30)
    turns = motion.rotations.copy()
    turns[15:, HUMANOID.index("rightFoot")] = (np.cos(np.pi / 4), 0, np.sin(np.pi / 4), 0)
    assert describe(motion)["turned_feet_ratio"] == 0
    assert describe(Motion(HUMANOID, turns, motion.root, 30))["turned_feet_ratio"] == pytest.approx(0.25)
