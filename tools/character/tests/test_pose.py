import numpy as np

from echoavatar.files.avatar import load_character
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_character.pose import DOWN, posed


def test_no_turns_are_the_rest_pose_and_lowered_arms_hang() -> None:
    character = load_character()
    points, normals, joints = posed(character, {})
    np.testing.assert_allclose(points, character.positions, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)
    _, _, lowered = posed(character, DOWN)
    for side in ("left", "right"):
        wrist = HUMANOID.index(f"{side}Hand")
        assert joints[wrist, 1] - lowered[wrist, 1] > 0.4


def test_a_face_moves_with_its_weights() -> None:
    character = load_character()
    weights = np.zeros(len(character.face.names), np.float32)
    weights[character.face.names.index("jawOpen")] = 1
    moved = np.abs(posed(character, {}, weights)[0] - character.positions).max()
    assert 0.005 < moved < 0.1
