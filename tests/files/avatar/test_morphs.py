import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.files.avatar.morphs import Morphs, added, checked_face


def some() -> tuple[Morphs, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    moves, turns = rng.normal(size=(3, 20, 3)) * 0.01, rng.normal(size=(3, 20, 3)) * 0.3
    still = rng.random((3, 20)) < 0.6
    moves[still], turns[still] = 0, 0
    moves[:, 17:], turns[:, 17:] = 0, 0
    moves[1, 16, 0] = 0.01
    return Morphs.of_dense(("a", "b", "c"), moves, turns), moves, turns


def test_sparse_shapes_add_up_as_full_ones() -> None:
    morphs, moves, turns = some()
    assert morphs.reach == 17
    weights = np.array([0.2, 0.7, 1.0], np.float32)
    positions, normals = np.zeros((20, 3), np.float32), np.tile(np.float32([0, 0, 1]), (20, 1))
    added(weights, morphs.starts, morphs.vertices, morphs.moves, morphs.turns, positions, normals, morphs.reach)
    np.testing.assert_allclose(positions, np.einsum("n,nvi->vi", weights, moves), atol=1e-6)
    turned = [0, 0, 1] + np.einsum("n,nvi->vi", weights, turns)
    np.testing.assert_allclose(normals, turned / np.linalg.norm(turned, axis=1, keepdims=True), atol=1e-5)


def test_what_hardly_moves_is_left_out() -> None:
    morphs, moves, _ = some()
    assert len(morphs.vertices) == (np.abs(moves).max(2) > 0).sum()


def test_stored_shapes_read_back() -> None:
    """Moves to a thousandth of a millimetre, turns to 1/128."""
    morphs, _, _ = some()
    again = Morphs.of_arrays(morphs.arrays())
    assert again.names == morphs.names
    np.testing.assert_array_equal(again.vertices, morphs.vertices)
    np.testing.assert_allclose(again.moves, morphs.moves, atol=1.1e-6)
    np.testing.assert_allclose(again.turns, morphs.turns, atol=1 / 127)


def test_faces_are_checked_and_clipped() -> None:
    np.testing.assert_array_equal(checked_face(np.full((2, 52), 1.5), 2), np.ones((2, 52)))
    with pytest.raises(MotionError, match="3 frames take"):
        checked_face(np.zeros((2, 52)), 3)
