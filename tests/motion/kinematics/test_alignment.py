import math

import numpy as np
from tests.motion.kinematics.samples import matrix_from_euler, swaying

from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics
from echoavatar.motion.kinematics.alignment import align, project_rotation
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion


def test_the_nearest_rotation_of_a_rotation_is_itself():
    turns = matrix_from_quaternion(np.random.default_rng(1).standard_normal((20, 4)))
    np.testing.assert_allclose(project_rotation(turns * 0.4), turns, atol=1e-5)
    flat = np.diag([1.0, 1.0, -0.1])
    assert np.linalg.det(project_rotation(flat)) > 0.999


def test_a_rig_fits_itself():
    motion = swaying(10, size=0.0)
    turns = motion.matrices().astype(np.float64)
    pose = forward_kinematics(HUMANOID, turns, motion.root.astype(np.float64))
    for turn in align(HUMANOID, pose, HUMANOID.config.vrm, HUMANOID, HUMANOID.config.vrm).values():
        np.testing.assert_allclose(turn, np.eye(3), atol=1e-6, rtol=0)


def test_an_a_pose_is_met_by_turning_the_arms():
    """Arms that rest 45 degrees lower in the source: its zero rotation is our arm turned down by 45 degrees."""
    lowered = matrix_from_euler(np.array([-math.pi / 4, 0, 0]), "zyx")
    offsets = [list(offset) for offset in HUMANOID.config.offsets]
    for joint, name in enumerate(HUMANOID.names):
        if name.startswith("left") and any(
            p in name for p in ("LowerArm", "Hand", "Thumb", "Index", "Middle", "Ring", "Little")
        ):
            offsets[joint] = (lowered @ np.array(offsets[joint])).tolist()
    source = Skeleton(
        HUMANOID.config.model_copy(update={"tips": {}, "offsets": tuple(tuple(offset) for offset in offsets)})
    )
    pose = forward_kinematics(source, np.tile(np.eye(3), (4, 52, 1, 1)), np.tile(source.offsets[0], (4, 1)))
    found = align(source, pose, source.config.vrm, HUMANOID, HUMANOID.config.vrm)
    np.testing.assert_allclose(found["leftUpperArm"], lowered.astype(np.float64), atol=1e-5, rtol=0)
    np.testing.assert_allclose(found["leftIndexIntermediate"], lowered.astype(np.float64), atol=2e-2, rtol=0)
    np.testing.assert_allclose(found["rightUpperArm"], np.eye(3), atol=1e-6, rtol=0)
