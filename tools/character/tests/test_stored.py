"""What is written here reads back in the avatar."""

from pathlib import Path

import numpy as np

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.character import Morphs, added
from echoavatar_character.stored import save, sparse


def some() -> tuple[Morphs, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    moves, turns = rng.normal(size=(3, 20, 3)) * 0.01, rng.normal(size=(3, 20, 3)) * 0.3
    still = rng.random((3, 20)) < 0.6
    moves[still], turns[still] = 0, 0
    moves[:, 17:], turns[:, 17:] = 0, 0
    moves[1, 16, 0] = 0.01
    return sparse(("a", "b", "c"), moves, turns), moves, turns


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


def test_save_and_load_agree(tmp_path: Path) -> None:
    """Pictures are kept whole, moves to a thousandth of a millimetre."""
    character = load_character()
    save(character, tmp_path / "copy.npz")
    again = load_character(tmp_path / "copy.npz")
    np.testing.assert_allclose(again.positions, character.positions)
    np.testing.assert_allclose(again.normals, character.normals, atol=1 / 127)
    np.testing.assert_array_equal(again.triangles, character.triangles)
    np.testing.assert_array_equal(again.face.vertices, character.face.vertices)
    np.testing.assert_allclose(again.face.moves, character.face.moves, atol=1e-6)
    np.testing.assert_allclose(again.face.turns, character.face.turns, atol=1 / 127)
    assert again.face.names == character.face.names
    assert (again.outfits, again.textures) == (character.outfits, character.textures)
    assert (tmp_path / "copy.npz").stat().st_size < 1_550_000
