import numpy as np
from tests.files.avatar.weights import bone_weights, humanoid_weights

from echoavatar.files.avatar import load_character, skin
from echoavatar.files.avatar.halfway import HALFWAY, SOURCES, half, with_halfway
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, matrix_from_quaternion


def test_twice_the_half_is_the_rotation() -> None:
    quaternions = np.random.default_rng(3).normal(size=(200, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    whole = matrix_from_quaternion(np.array(quaternions))
    part = matrix_from_quaternion(np.array(half(quaternions)))
    np.testing.assert_allclose(part @ part, whole, atol=1e-9)
    assert (np.trace(part, axis1=1, axis2=2) > 1 - 1e-9).all()  # a right angle at most: the short way


def test_a_halfway_bone_turns_by_half_of_its_bone_about_the_same_joint() -> None:
    """In a world that is turned as well; quaternions of files and matrices of films agree."""
    turns = np.zeros((HUMANOID.joints, 3), np.float32)
    turns[0] = np.array([0.1, 2.0, -0.3])
    for number, joint in enumerate(SOURCES):
        turns[joint] = np.array([0.4 - 0.2 * number, -2.0 + 0.3 * number, 0.5])
    pose = forward_kinematics(HUMANOID, matrix_from_axis_angle(turns), HUMANOID.rest_positions[0])
    rotations, places = with_halfway(pose.rotations, pose.positions)
    for row, joint in enumerate(SOURCES):
        above = pose.rotations[HUMANOID.parents[joint]]
        expected = above @ matrix_from_axis_angle(turns[joint] / 2)
        np.testing.assert_allclose(rotations[HUMANOID.joints + row], expected, atol=1e-5)
        np.testing.assert_allclose(places[HUMANOID.joints + row], pose.positions[joint])


def test_a_turn_by_180_degrees_is_finite() -> None:
    rotations = np.tile(np.eye(3, dtype=np.float32), (HUMANOID.joints, 1, 1))
    rotations[list(SOURCES)] = np.diag([-1.0, 1.0, -1.0])
    turned, _ = with_halfway(rotations, HUMANOID.rest_positions)
    assert np.isfinite(turned).all()


def test_the_shipped_characters_bend_over_halfway_bones() -> None:
    """The sleeve at each joint follows its halfway bone, which only a turn of that bone moves."""
    character = load_character()
    np.testing.assert_allclose(humanoid_weights(character).sum(1), 1, atol=1e-5)
    for row, name in enumerate(HALFWAY):
        share = bone_weights(character)[:, HUMANOID.joints + row]
        assert (share > 0.5).sum() > 20
        local = np.tile(np.eye(3, dtype=np.float32), (HUMANOID.joints, 1, 1))
        local[HUMANOID.index(name)] = matrix_from_axis_angle(np.array([0.0, 0.0, 1.0]))
        pose = forward_kinematics(HUMANOID, local, HUMANOID.rest_positions[0])
        points, _ = skin(character, pose.rotations, pose.positions)
        moved = np.linalg.norm(points - character.positions, axis=1)
        assert moved[share > 0.5].mean() > 0.004
