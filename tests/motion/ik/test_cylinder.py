"""The paper's cylinder on our own character."""

import math

import numpy as np
import pytest
from tests import golden as fixtures
from tests.motion.ik.poses import left_wrist_at

from echoavatar.motion.formats import read_bvh
from echoavatar.motion.ik import Cylinder
from echoavatar.motion.ik.cylinder import SwingConfig, radius_at, remapped_distance, swing_between, swing_clear
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import (
    angle_between,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_matrix,
    unit,
)

REFERENCE = SwingConfig(  # centimetres, Z up: the reference character's
    profile=((-80, 22), (-40, 22), (-5, 21), (0, 21), (10, 20), (30, 16), (40, 35), (55, 35), (80, 35)), up=2, snap=1e-6
)


def golden() -> dict[str, np.ndarray]:
    with np.load(fixtures.golden("reference_release/ik.npz")) as stored:
        return {name: stored[name] for name in stored}


def test_rotations_are_those_of_the_reference_release() -> None:
    """24 frames of the reference's 88-joint rig; 18 right and 10 left arms are corrected, nothing else moves."""
    stored = golden()
    skeleton = read_bvh(fixtures.golden("reference_release/sample_60fps.bvh"), metres_per_unit=1.0).skeleton
    arms = tuple((skeleton.index(f"Shoulder_{s}"), skeleton.index(f"Wrist_{s}")) for s in "RL")
    ours = swing_clear(skeleton, stored["R_in"], REFERENCE, arms)
    np.testing.assert_allclose(ours, stored["R_out"], atol=1e-5, rtol=0)
    moved = (np.abs(ours - stored["R_in"]) > 1e-5).any((-1, -2))
    assert [int(moved[:, shoulder].sum()) for shoulder, _ in arms] == [18, 10]
    assert int(moved.sum()) == 28


def test_without_the_snap_the_reference_is_met_to_its_snap() -> None:
    stored = golden()
    skeleton = read_bvh(fixtures.golden("reference_release/sample_60fps.bvh"), metres_per_unit=1.0).skeleton
    arms = tuple((skeleton.index(f"Shoulder_{s}"), skeleton.index(f"Wrist_{s}")) for s in "RL")
    ours = swing_clear(skeleton, stored["R_in"], REFERENCE.model_copy(update={"snap": 0.0}), arms)
    np.testing.assert_allclose(ours, stored["R_out"], atol=2e-3, rtol=0)


def test_radius_remap_and_swing_are_those_of_the_reference_release() -> None:
    stored = golden()
    np.testing.assert_allclose(radius_at(stored["thr_z"], REFERENCE), stored["thr"], atol=1e-5, rtol=0)
    twenty = np.full_like(stored["remap_d"], 20.0)
    used = stored["remap_d"] <= 30
    ours = remapped_distance(stored["remap_d"], twenty)
    np.testing.assert_allclose(ours[used], stored["remap_thr20"][used], atol=1e-5, rtol=0)
    turns = swing_between(stored["vec_a"], stored["vec_b"], 1e-6)
    ours = (turns[3:] @ stored["vec_a"][3:, :, None])[..., 0]
    np.testing.assert_allclose(turns[3:], stored["rot_a_to_b"][3:], atol=1e-5, rtol=0)
    assert np.isfinite(ours).all()


def test_the_remap_keeps_the_order_and_ends_where_it_began() -> None:
    distance = np.linspace(0, 0.3, 301, dtype=np.float64)
    radius = np.full_like(distance, 0.2)
    far = remapped_distance(distance, radius)
    assert far[0] == 0.2
    assert far[-1] == pytest.approx(0.3)
    assert (np.diff(far) > -1e-12).all()


def test_the_arm_points_at_the_target() -> None:
    """A left hand in the belly: afterwards shoulder, hand and remapped hand are in line."""
    upper, wrist = HUMANOID.index("leftUpperArm"), HUMANOID.index("leftHand")
    rotations, root = left_wrist_at(np.array([[0.05, 0.2, 0.05]])), np.zeros((1, 3))
    config = SwingConfig(profile=((-0.2, 0.2), (0.6, 0.2)))
    cleared = swing_clear(HUMANOID, rotations, config, ((upper, wrist),))
    before, after = (forward_kinematics(HUMANOID, r, root).positions[0] for r in (rotations, cleared))
    hand = before[wrist] * np.array([1.0, 0, 1.0])
    distance = np.linalg.norm(hand)
    target = before[wrist] + hand * (remapped_distance(distance, np.array(0.2)) / distance - 1)
    wanted, got = target - before[upper], after[wrist] - after[upper]
    assert (unit(wanted) * unit(got)).sum(-1).item() == pytest.approx(1, abs=1e-6)
    assert angle_between(rotations[0, upper], cleared[0, upper]) > math.radians(5)


def folded(radians: float) -> np.ndarray:
    """The T-pose with both forearms folded back by an angle; at 2.9 the hands are at the neck."""
    turns = np.zeros((1, 1, HUMANOID.joints, 4), np.float32)
    turns[..., 0] = 1
    for side, sign in (("left", -1), ("right", 1)):
        bent = matrix_from_axis_angle(np.array([0.0, sign * radians, 0.0]))
        turns[0, 0, HUMANOID.index(f"{side}LowerArm")] = quaternion_from_matrix(bent)
    return turns


def distance(turns: np.ndarray, joint: str) -> float:
    """Horizontal distance from the vertical axis through the hips."""
    pose = forward_kinematics(HUMANOID, matrix_from_quaternion(turns), np.zeros((1, 1, 3), np.float32))
    return float(np.linalg.norm(pose.positions[0, 0, HUMANOID.index(joint), [0, 2]]))


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
