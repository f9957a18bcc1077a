import numpy as np

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.render import Paint
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_character.sheets import ACTIONS, DOWN, EXPRESSIONS, POSES, SCRIPTS, around, grid, shot, stills


def test_a_sheet_shows_every_pose_and_expression_differently() -> None:
    assert len(EXPRESSIONS) == 12
    assert len(POSES) == 20
    character = load_character()
    paint = Paint.of(character)
    cells = [shot(character, paint, around(8, 0.85, 1.575, 0.33), (40, 44), DOWN, face) for face in EXPRESSIONS[:3]]
    assert len({cell.tobytes() for cell in cells}) == 3
    assert grid(cells, 3).shape == (44, 120, 3)
    assert np.stack(cells).max() > 100


def test_stills_show_body_and_face_of_a_frame() -> None:
    """Three frames, of which one has another pose and one another face."""
    rotations = np.tile(np.float32([1, 0, 0, 0]), (3, 52, 1))
    rotations[1, HUMANOID.index("leftUpperArm")] = np.float32([np.cos(0.5), 0, 0, -np.sin(0.5)])
    root = np.tile(HUMANOID.rest_positions[0], (3, 1))
    face = np.zeros((3, 52), np.float32)
    face[2, 5:20] = 1
    motion = Motion(HUMANOID, rotations, root, 30.0)
    still, raised, faced = stills(load_character(), motion, face, [0, 1, 2], "bust")
    assert (still != raised).any()
    assert (still != faced).any()
    assert set(ACTIONS) <= set(SCRIPTS)
