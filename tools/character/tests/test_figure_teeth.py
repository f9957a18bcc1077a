import numpy as np
import pytest

from echoavatar_character.figure_mouth import HEIGHT
from echoavatar_character.figure_teeth import GUM, teeth, tongue, vertex_normals


@pytest.mark.parametrize("upper", [True, False])
def test_a_row_of_teeth_is_symmetric_and_its_gum_is_away_from_the_lips(upper: bool) -> None:
    mesh, colours = teeth(upper=upper)
    mirrored = mesh.positions * [-1, 1, 1]
    nearest = np.linalg.norm(mesh.positions[:, None] - mirrored[None], axis=2).min(0)
    assert nearest.max() < 1e-6
    gum = np.abs(colours - GUM).sum(1) < 30
    away = np.abs(mesh.positions[:, 1] - HEIGHT)
    assert away[gum].min() > 0.008
    front = mesh.positions[:, 2].argmax()
    assert mesh.normals[front, 2] > 0.3  # looks out of the mouth


def test_the_tongue_lies_behind_the_teeth() -> None:
    tip = tongue()[0].positions[:, 2].max()
    assert tip < teeth(upper=False)[0].positions[:, 2].max()


def test_normals_of_a_flat_square_are_upright() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    normals = vertex_normals(square, np.array([[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_allclose(normals, np.tile([0, 0, 1.0], (4, 1)))
