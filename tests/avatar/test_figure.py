import numpy as np

from echoavatar.avatar.character import MATERIALS
from echoavatar.avatar.figure import IRIS, PIECES, PUPIL, eyeball, piece_colours
from echoavatar.avatar.figure_head import EYE, EYE_RADIUS


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


def test_eyes_look_ahead_with_pupil_inside_iris() -> None:
    mesh, colours = eyeball(1.0)
    front = mesh.positions[np.argmax(mesh.positions[:, 2])]
    np.testing.assert_allclose(front, EYE + (0, 0, EYE_RADIUS), atol=1e-6)
    angle = np.arccos(np.clip(mesh.normals[:, 2], -1, 1))
    assert angle[(colours == PUPIL).all(1)].max() < angle[(colours == IRIS).all(1)].min()


def test_lips_are_painted_on_the_mouth_and_not_on_the_neck() -> None:
    head = next(piece for piece in PIECES if piece.name == "head")
    mouth, neck = piece_colours(head, np.array([[0.0, 1.517, 0.085], [0.0, 1.44, 0.02]]))
    assert mouth[1] < neck[1] - 30
