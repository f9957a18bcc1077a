"""The paper's cylinder on our own character."""

import numpy as np
import torch

from echoavatar.motion.ik import Cylinder
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import (
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_matrix,
)


def folded(radians: float) -> np.ndarray:
    """The T-pose with both forearms folded back by an angle; at 2.9 the hands are at the neck."""
    turns = np.zeros((1, 1, HUMANOID.joints, 4), np.float32)
    turns[..., 0] = 1
    for side, sign in (("left", -1), ("right", 1)):
        bent = matrix_from_axis_angle(torch.tensor([0.0, sign * radians, 0.0]))
        turns[0, 0, HUMANOID.index(f"{side}LowerArm")] = quaternion_from_matrix(bent)
    return turns


def distance(turns: np.ndarray, joint: str) -> float:
    """Horizontal distance from the vertical axis through the hips."""
    pose = forward_kinematics(HUMANOID, matrix_from_quaternion(torch.from_numpy(turns)), torch.zeros(1, 1, 3))
    return float(pose.positions[0, 0, HUMANOID.index(joint), [0, 2]].norm())


def test_arms_that_are_far_from_the_body_return_as_they_were() -> None:
    given = folded(0)
    np.testing.assert_array_equal(Cylinder(HUMANOID).resolve(given), given)


def test_hands_in_the_body_are_swung_out_and_only_shoulders_turn() -> None:
    given = folded(2.9)
    clear = Cylinder(HUMANOID).resolve(given)
    changed = np.flatnonzero((clear != given).any(-1).ravel())
    assert set(changed) == {HUMANOID.index("leftUpperArm"), HUMANOID.index("rightUpperArm")}
    for hand in ("leftHand", "rightHand"):
        assert distance(clear, hand) > distance(given, hand) + 0.01


def test_the_cylinder_is_as_wide_as_the_body() -> None:
    radii = [radius for _, radius in Cylinder(HUMANOID).config.profile]
    assert min(radii) > 0.05
    assert max(radii) < 0.30
