"""Controls of captured motion: what the solver made comes back, and a stranger's motion comes near."""

from dataclasses import replace

import numpy as np
import pytest

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.corpora.capture.controls_from_motion import controls_from_motion
from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, Controls, neutral, wander
from echoavatar_lab.corpora.solver import solve

LOOSE = {"wrist": 0.05, "spine": 0.15, "head": 0.2, "palm": 0.2, "elbow_swing": 0.3, "shoulder": 0.1, "fingers": 0.08}


def moving(frames: int = 60) -> Controls:
    """A body that bows, turns, reaches, points a foot and walks its hips about."""
    rng = np.random.default_rng(3)
    base = neutral(frames)
    curves = {}
    for name, size in {**LOOSE, "foot_yaw": 0.3, "knee_swing": 0.2, "foot_roll": 0.15, "pelvis_rotation": 0.2}.items():
        still = getattr(base, name)
        drift = wander(frames, int(np.prod(still.shape[1:])), period=2.0, rng=rng).reshape(still.shape)
        curves[name] = still + size * np.clip(drift, -2, 2)
    curves["wrist"] += np.array([0.15, 0.25, 0.25], np.float32)
    curves["foot_position"] = base.foot_position + np.array([0, 0.05, 0.1], np.float32)
    curves["pelvis_position"] = base.pelvis_position - np.array([0, 0.1, 0], np.float32)
    return replace(base, **curves)


def motion_of(controls: Controls) -> Motion:
    return Motion(HUMANOID, *solve(controls), 30.0)


def test_the_solver_s_motion_comes_back():
    controls = moving()
    motion = motion_of(controls)
    again = motion_of(controls_from_motion(motion))
    apart = np.linalg.norm(motion.pose().positions - again.pose().positions, axis=-1)
    body = HUMANOID.indices(("leftHand", "rightHand", "head", "leftFoot", "rightLowerLeg", "leftLowerArm"))
    assert apart[:, body].max() < 0.004
    assert apart.max() < 0.015  # fingertips


@pytest.mark.parametrize("name", ["spine", "head", "foot_yaw", "foot_roll", "knee_swing", "elbow_swing", "shoulder"])
def test_each_curve_comes_back(name):
    controls = moving()
    found = controls_from_motion(motion_of(controls))
    np.testing.assert_allclose(getattr(found, name), getattr(controls, name), atol=0.12 if "knee" in name else 0.03)


def test_a_leg_thrown_backwards_keeps_its_heading():
    """The sole looks up: the foot's pitch passes the vertical instead of the yaw turning round."""
    base = neutral(30)
    place, pitch = base.foot_position.copy(), base.foot_pitch.copy()
    rise = np.linspace(0, 1, 30, dtype=np.float32)
    place[:, 0] += rise[:, None] * np.array([0.0, 0.55, -0.45], np.float32)
    pitch[:, 0] = 2.2 * rise
    found = controls_from_motion(motion_of(replace(base, foot_position=place, foot_pitch=pitch)))
    assert np.abs(np.diff(found.foot_yaw[:, 0])).max() < 0.1
    assert found.foot_pitch[-1, 0] == pytest.approx(2.2, abs=0.02)


def test_standing_feet_stay_where_they_are():
    found = controls_from_motion(motion_of(neutral(5)))
    np.testing.assert_allclose(found.foot_position, neutral(5).foot_position, atol=1e-4)
    assert found.foot_position[..., 1] == pytest.approx(ANKLE_HEIGHT, abs=1e-4)


def test_fingers_that_were_not_captured_are_relaxed():
    turns = np.zeros((4, HUMANOID.joints, 4), np.float32)
    turns[..., 0] = 1
    root = np.tile(HUMANOID.offsets[0], (4, 1))
    found = controls_from_motion(Motion(HUMANOID, turns, root, 30.0))
    np.testing.assert_allclose(found.fingers, neutral(4).fingers)
