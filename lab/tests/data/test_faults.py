import numpy as np
import pytest
import torch
from tests.motion.ik.poses import left_wrist_at

from echoavatar.errors import MotionError
from echoavatar.motion.ik import BodyProfile, RoundedPart
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar_lab.data.faults import penetration_depth_m, skate

REST = HUMANOID.rest_positions


def ball(radius: float) -> BodyProfile:
    """A ball around the point 0.2 m above and 0.3 m ahead of the hips; hands without thickness."""
    part = RoundedPart(bone="hips", centre=(0.0, 0.2, 0.3), radii=(radius, radius, radius))
    return BodyProfile(parts=(part,), palm=0.0, finger=0.0)


def test_depth_is_the_way_to_the_skin() -> None:
    """The wrist 4 cm from the centre of a ball of 6 cm: 2 cm at least, and 1 cm more for a thicker hand."""
    pose = left_wrist_at(np.array([[0.0, 0.24, 0.3]]))
    open_way = matrix_from_axis_angle(np.zeros((1, HUMANOID.joints, 3), np.float32))
    deep = penetration_depth_m(HUMANOID, np.concatenate([pose, open_way]), ball(0.06))
    assert deep.shape == (2, 2)
    assert deep[0, 0] >= 0.02 - 1e-5
    assert deep[0, 1] == 0
    assert (deep[1] == 0).all()
    thick = ball(0.06).model_copy(update={"palm": 0.01, "finger": 0.01})
    assert penetration_depth_m(HUMANOID, pose, thick)[0, 0] == pytest.approx(deep[0, 0].item() + 0.01, abs=1e-5)


def test_the_body_turns_with_its_bone() -> None:
    """An ellipsoid of three different radii on the turned hips: the depth is that before the turn."""
    part = RoundedPart(bone="hips", centre=(0.0, 0.2, 0.3), radii=(0.05, 0.1, 0.2))
    profile = BodyProfile(parts=(part,), palm=0.0, finger=0.0)
    pose = left_wrist_at(np.array([[0.0, 0.24, 0.3]]))
    turned = pose.copy()
    turned[:, 0] = matrix_from_axis_angle(np.array([0.3, 1.0, -0.4])) @ pose[:, 0]
    deep = penetration_depth_m(HUMANOID, pose, profile)
    assert deep[0, 0] > 0.01
    np.testing.assert_allclose(penetration_depth_m(HUMANOID, turned, profile), deep, atol=1e-5, rtol=0)


def test_a_hand_beside_the_ball_is_outside() -> None:
    pose = left_wrist_at(np.array([[0.25, 0.2, 0.3]]))
    assert penetration_depth_m(HUMANOID, pose, ball(0.02)).max() == 0


def test_frames_that_are_not_finite_are_refused() -> None:
    rotations = matrix_from_axis_angle(np.zeros((2, HUMANOID.joints, 3), np.float32))
    rotations[1, 3, 0, 0] = torch.inf
    with pytest.raises(MotionError, match="not finite"):
        penetration_depth_m(HUMANOID, rotations)


def one_foot(height, x):
    """Places (t, 1, 3)."""
    return np.stack([np.asarray(x, float), np.asarray(height, float), np.zeros(len(height))], -1)[:, None]


def test_a_sliding_foot_cannot_hide():
    """Half a metre per second along the floor is 50 cm/s of skate, however fast that is."""
    place = one_foot(np.full(30, 0.08), np.arange(30) * 0.5 / 30)
    assert skate(place, 30) == pytest.approx(50)


def test_one_of_two_feet_sliding_is_half():
    still, sliding = one_foot(np.full(30, 0.08), np.zeros(30)), one_foot(np.full(30, 0.08), np.arange(30) * 0.2 / 30)
    assert skate(np.concatenate([still, sliding], 1), 30) == pytest.approx(10)


def test_no_contact_is_no_skate():
    assert skate(one_foot(np.full(10, 0.5), np.arange(10)), 30, standing_height=0.08) == 0
