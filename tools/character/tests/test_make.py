from pathlib import Path

import numpy as np
import pytest

from echoavatar.files.avatar import load_character
from echoavatar_character.figure import PIECES
from echoavatar_character.make import SHIPPED, build, inside_box, without_buried
from echoavatar_character.sculpt import Mesh


def test_triangles_deep_inside_another_piece_are_dropped() -> None:
    """A small triangle in the middle of the head, of a mesh that is said to be the hair's, is never seen."""
    hair, head = (next(piece for piece in PIECES if piece.name == name) for name in ("hair", "head"))
    middle = (np.asarray(head.low) + np.asarray(head.high)) / 2
    corners = np.array([[0, 0, 0], [0.001, 0, 0], [0, 0.001, 0]])
    assert inside_box(head, middle + corners).all()
    assert (head.field(middle + corners) < -hair.buried).all()
    outside = middle + corners + [0, 1, 0]
    mesh = Mesh(np.concatenate([middle + corners, outside]), np.zeros((6, 3)), np.arange(6).reshape(2, 3))
    seen = without_buried(hair, mesh)
    np.testing.assert_array_equal(seen.positions, outside)
    np.testing.assert_array_equal(seen.triangles, [[0, 1, 2]])


@pytest.mark.slow
def test_the_shipped_character_is_the_one_made_here(tmp_path: Path) -> None:
    """Vertices agree to a tenth of a millimetre: other builds of the libraries round otherwise."""
    assert SHIPPED.is_file()
    build().save(tmp_path / "character.npz")
    made, shipped = load_character(tmp_path / "character.npz"), load_character()
    np.testing.assert_array_equal(made.triangles, shipped.triangles)
    np.testing.assert_allclose(made.positions, shipped.positions, atol=1e-4)
