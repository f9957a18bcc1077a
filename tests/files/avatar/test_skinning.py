import time
from collections.abc import Callable

import numpy as np

from echoavatar.files.avatar import load_character, skin
from echoavatar.files.avatar.halfway import REST, with_halfway
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, matrix_from_quaternion

Wave = Callable[[int], tuple[np.ndarray, np.ndarray]]


def test_the_rest_pose_returns_the_mesh() -> None:
    character = load_character()
    eye = np.tile(np.eye(3), (HUMANOID.joints, 1, 1))
    vertices, normals = skin(character, eye, HUMANOID.rest_positions)
    np.testing.assert_allclose(vertices, character.positions, atol=1e-5)
    np.testing.assert_allclose(normals, character.normals, atol=1e-5)


def test_skinning_equals_a_naive_loop_over_influences(wave: Wave) -> None:
    character = load_character()
    rotations, root = wave(40)
    pose = forward_kinematics(HUMANOID, matrix_from_quaternion(np.array(rotations[37])), np.array(root[37]))
    turns, places = pose.rotations, pose.positions
    vertices, _ = skin(character, turns, places)
    turns, places = with_halfway(turns, places)
    rest = REST
    for v in range(0, len(vertices), 997):
        expected = np.zeros(3)
        for joint, weight in zip(character.joints[v], character.weights[v], strict=True):
            expected += weight * (turns[joint] @ (character.positions[v] - rest[joint]) + places[joint])
        np.testing.assert_allclose(vertices[v], expected, atol=1e-4)


def test_turning_the_head_leaves_the_feet() -> None:
    character = load_character()
    rotations = np.tile(np.eye(3, dtype=np.float32), (HUMANOID.joints, 1, 1))
    rotations[HUMANOID.index("head")] = matrix_from_axis_angle(np.array([0.0, 0.8, 0.0]))
    pose = forward_kinematics(HUMANOID, rotations, HUMANOID.rest_positions[0])
    vertices, _ = skin(character, pose.rotations, pose.positions)
    moved = np.linalg.norm(vertices - character.positions, axis=1)
    assert moved[character.positions[:, 1] < 1.3].max() < 1e-5
    assert moved[character.positions[:, 1] > 1.6].max() > 0.05


def test_an_expression_rides_on_the_pose() -> None:
    """The open jaw of a head turned by a quarter moves sideways what it moves forwards at rest."""
    character = load_character()
    rotations = np.tile(np.eye(3, dtype=np.float32), (HUMANOID.joints, 1, 1))
    rotations[HUMANOID.index("head")] = matrix_from_axis_angle(np.array([0.0, np.pi / 2, 0.0]))
    pose = forward_kinematics(HUMANOID, rotations, HUMANOID.rest_positions[0])
    turns, places = pose.rotations, pose.positions
    face = np.zeros(52, np.float32)
    face[character.face.names.index("jawForward")] = 1
    moved = skin(character, turns, places, face)[0] - skin(character, turns, places)[0]
    straight = character.with_face(face)[0] - character.positions
    chin = np.argmax(np.abs(straight).sum(1))
    x, y, z = straight[chin]
    assert z > 0.005
    np.testing.assert_allclose(moved[chin], [z, y, -x], atol=1e-5)


def test_one_frame_is_fast() -> None:
    """A frame of video has 33 ms; skinning must stay a small part of it (processor time, best of ten)."""
    character = load_character()
    eye, places = np.tile(np.eye(3), (HUMANOID.joints, 1, 1)), HUMANOID.rest_positions
    skin(character, eye, places)
    spent = []
    for _ in range(10):
        start = time.process_time()
        skin(character, eye, places)
        spent.append(time.process_time() - start)
    assert min(spent) < 0.015
