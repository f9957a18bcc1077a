import gzip
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from tests.files.avatar.weights import humanoid_weights

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.files.avatar import CHARACTERS, LEVELS, MATERIALS, level_file, load_character
from echoavatar.files.avatar.character import NAMES, REDUCTIONS, checked_face, looked_up
from echoavatar.files.avatar.gltf import pack_glb
from echoavatar.files.avatar.halfway import BONES
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID


def test_pictures_come_back_with_their_reductions() -> None:
    """Each level has half the sides of the one before; only hair has clear texels."""
    texels, _ = load_character().texels
    assert texels.table.shape == (len(NAMES), REDUCTIONS, 3)
    np.testing.assert_array_equal(texels.table[:, 1, 1:] * 2, texels.table[:, 0, 1:])
    for row, name in enumerate(NAMES):
        start, width, height = texels.table[row, 0]
        alpha = texels.values[start : start + width * height, 3]
        assert (alpha.min() < 10) == (name == "hair")


@pytest.mark.parametrize("name", CHARACTERS)
def test_each_has_three_outfits_that_differ(name: str) -> None:
    """An outfit is another picture on the same clothes: most of its texels have another colour."""
    character = load_character(name)
    assert len(set(character.outfits)) == 3
    first, *others = (load_character(f"{name}/{outfit}") for outfit in character.outfits)
    assert first.textures["outfit"] == character.textures["outfit"]
    (start, wide, high), seen = first.texels[0].table[NAMES.index("outfit"), 2], first.texels[0].values
    for other in others:
        assert (other.outfits, other.textures.keys()) == ((other.outfits[0],), first.textures.keys())
        apart = other.texels[0].values[start:][: wide * high, :3].astype(int) - seen[start:][: wide * high, :3]
        assert (np.abs(apart).max(1) > 25).mean() > 0.4


def test_an_unknown_outfit_is_named_with_those_there_are() -> None:
    with pytest.raises(CheckpointError, match=r"no outfit 'Toga'; choose from \w+, \w+, \w+"):
        load_character("theo/Toga")


def test_places_find_their_colour() -> None:
    """A place outside any picture is white; skin is redder than blue wherever a face lies."""
    character = load_character()
    texels, _ = character.texels
    found = looked_up(texels, np.array([-1, 0]), np.array([[0.5, 0.5], [0.45, 0.5]], np.float32))
    np.testing.assert_array_equal(found[0], 1)
    assert found[1, 0] > found[1, 2]


def test_faces_are_checked_and_clipped() -> None:
    np.testing.assert_array_equal(checked_face(np.full((2, 52), 1.5), 2), np.ones((2, 52)))
    with pytest.raises(MotionError, match="3 frames take"):
        checked_face(np.zeros((2, 52)), 3)


@pytest.mark.parametrize("name", CHARACTERS)
def test_a_shipped_character_is_whole(name: str) -> None:
    """Size, bones, curves and bounds are what renderers, exports and the page's budget expect."""
    character = load_character(name)
    assert 30_000 < len(character.triangles) < 52_000
    assert character.triangles.max() < len(character.positions) < 65_536
    np.testing.assert_allclose(character.weights.sum(1), 1, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(character.normals, axis=1), 1, atol=1e-4)
    assert character.joints.max() < len(BONES)
    assert (humanoid_weights(character).max(0) > 0.3).all()
    assert set(character.materials) == set(range(len(MATERIALS)))
    assert character.face.names == tuple(ARKIT_NAMES)
    assert (np.diff(character.face.starts) > 20).all()  # every curve moves something
    low, high = character.positions.min(0), character.positions.max(0)
    assert abs(low[1]) < 0.004  # stands on the floor
    assert 1.66 < high[1] < 1.78
    np.testing.assert_allclose(low[0], -high[0], atol=0.01)


@pytest.mark.parametrize("name", CHARACTERS)
def test_a_shipped_character_fits_the_wire(name: str) -> None:
    """Programs without a decoder of compressed levels read this file."""
    assert len(gzip.compress(pack_glb(load_character(name), []), 6)) < 1_800_000


@pytest.mark.parametrize("name", CHARACTERS)
def test_levels_of_detail_have_all_bones_and_curves_and_get_smaller(name: str) -> None:
    counts, sizes = [], []
    for level in range(LEVELS):
        data = level_file(name, level).read_bytes()
        magic, version, total, length = struct.unpack("<4sIII", data[:16])
        assert (magic, version, total) == (b"glTF", 2, len(data))
        document = json.loads(data[20 : 20 + length])
        assert document["extensionsRequired"]
        names = {node.get("name") for node in document["nodes"]}
        assert set(HUMANOID.names) <= names
        face = next(mesh for mesh in document["meshes"] if mesh["name"] == "face")
        assert face["extras"]["targetNames"] == list(ARKIT_NAMES)
        parts = [part for mesh in document["meshes"] for part in mesh["primitives"]]
        counts.append(sum(document["accessors"][part["indices"]]["count"] // 3 for part in parts))
        sizes.append(len(data))
    assert 36_000 < counts[0] < 44_000
    assert 14_000 < counts[1] < 17_000
    assert 5_500 < counts[2] < 7_000
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] < 500_000  # what the page loads first


def test_an_unknown_level_or_name_is_refused_in_words() -> None:
    with pytest.raises(CheckpointError, match="level of detail 3"):
        level_file("maya", 3)
    with pytest.raises(CheckpointError, match="'nobody'"):
        level_file("nobody", 0)


def test_triangles_face_along_their_normals() -> None:
    """Hair and lashes are lit as one volume and seen from both sides, so theirs need not."""
    character = load_character()
    strands = np.array([material.name in ("hair", "lash") for material in MATERIALS])
    triangles = character.triangles[~strands[character.materials[character.triangles[:, 0]]]]
    a, b, c = (character.positions[triangles[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    agree = np.einsum("fi,fi->f", face, character.normals[triangles].mean(1)) > 0
    assert agree.mean() > 0.985


def test_an_expression_leaves_the_body_alone_and_keeps_normals_unit() -> None:
    character = load_character()
    positions, normals = character.with_face(np.full(52, 0.5, np.float32))
    reach = character.face.reach
    np.testing.assert_array_equal(positions[reach:], character.positions[reach:])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)
    assert np.abs(positions[:reach] - character.positions[:reach]).max() > 0.005
    rest, _ = character.with_face(np.zeros(52, np.float32))
    np.testing.assert_array_equal(rest, character.positions)


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(b"no zip")
    with pytest.raises(CheckpointError, match="bad.npz is not a character"):
        load_character(tmp_path / "bad.npz")
    with pytest.raises(CheckpointError, match="there is no character 'nobody'; choose from maya"):
        load_character("nobody")
    with pytest.raises(CheckpointError, match=r"none.npz"):
        load_character(tmp_path / "none.npz")
