import numpy as np

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.render import Paint
from echoavatar_character.sheets import DOWN, EXPRESSIONS, POSES, around, grid, shot


def test_a_sheet_shows_every_pose_and_expression_differently() -> None:
    assert len(EXPRESSIONS) == 12
    assert len(POSES) == 20
    character = load_character()
    paint = Paint.of(character)
    cells = [shot(character, paint, around(8, 0.85, 1.575, 0.33), (40, 44), DOWN, face) for face in EXPRESSIONS[:3]]
    assert len({cell.tobytes() for cell in cells}) == 3
    assert grid(cells, 3).shape == (44, 120, 3)
    assert np.stack(cells).max() > 100
