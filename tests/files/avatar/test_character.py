from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import CheckpointError
from echoavatar.files.avatar import MATERIALS, load_character
from echoavatar.motion.kinematics import HUMANOID


def test_the_shipped_character_is_whole() -> None:
    character = load_character()
    assert 20_000 < len(character.triangles) < 46_000
    assert character.triangles.max() < len(character.positions)
    np.testing.assert_allclose(character.weights.sum(1), 1, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(character.normals, axis=1), 1, atol=1e-4)
    assert character.joints.max() < HUMANOID.joints
    assert set(character.materials) == set(range(len(MATERIALS)))
    low, high = character.positions.min(0), character.positions.max(0)
    assert abs(low[1]) < 0.003  # stands on the floor
    assert 1.68 < high[1] < 1.74
    np.testing.assert_allclose(low[0], -high[0], atol=0.003)


def test_triangles_face_along_their_normals() -> None:
    character = load_character()
    a, b, c = (character.positions[character.triangles[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    agree = np.einsum("fi,fi->f", face, character.normals[character.triangles].mean(1)) > 0
    assert agree.mean() > 0.999


def test_every_joint_moves_something() -> None:
    assert (load_character().dense_weights.max(0) > 0.3).all()


def test_save_and_load_agree(tmp_path: Path) -> None:
    character = load_character()
    character.save(tmp_path / "copy.npz")
    again = load_character(tmp_path / "copy.npz")
    np.testing.assert_allclose(again.positions, character.positions)
    np.testing.assert_allclose(again.normals, character.normals, atol=1e-4)
    np.testing.assert_array_equal(again.triangles, character.triangles)
    np.testing.assert_array_equal(again.face.vertices, character.face.vertices)
    np.testing.assert_allclose(again.face.moves, character.face.moves, atol=1e-6)
    assert again.face.names == character.face.names
    assert (tmp_path / "copy.npz").stat().st_size < 1_200_000


def test_an_expression_leaves_the_body_alone_and_keeps_normals_unit() -> None:
    character = load_character()
    positions, normals = character.with_face(np.full(52, 0.5, np.float32))
    reach = character.face.reach
    np.testing.assert_array_equal(positions[reach:], character.positions[reach:])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)
    assert np.abs(positions[:reach] - character.positions[:reach]).max() > 0.01
    rest, _ = character.with_face(np.zeros(52, np.float32))
    np.testing.assert_array_equal(rest, character.positions)


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(b"no zip")
    with pytest.raises(CheckpointError, match="bad.npz is not a character"):
        load_character(tmp_path / "bad.npz")
    with pytest.raises(CheckpointError, match=r"none.npz"):
        load_character(tmp_path / "none.npz")
