import numpy as np

from echoavatar.files.avatar.character import MATERIALS
from echoavatar_character.figure import PIECES, piece_colours


def test_every_piece_has_a_known_material_and_closes_inside_its_box() -> None:
    names = {material.name for material in MATERIALS}
    for piece in PIECES:
        assert piece.material in names
        low, high = np.asarray(piece.low), np.asarray(piece.high)
        rng = np.random.default_rng(0)
        p = low + rng.random((600, 3)) * (high - low)
        side = rng.integers(0, 3, 600)
        p[np.arange(600), side] = np.where(rng.random(600) < 0.5, low[side], high[side])
        assert (piece.field(p) > 0).all(), piece.name


def test_lips_are_painted_on_the_mouth_and_not_on_the_neck() -> None:
    head = next(piece for piece in PIECES if piece.name == "head")
    mouth, neck = piece_colours(head, np.array([[0.0, 1.517, 0.085], [0.0, 1.44, 0.02]]))
    assert mouth[1] < neck[1] - 30
