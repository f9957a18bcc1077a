import json
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.gltf import HALFWAY_NODES, Buffer, GltfAnimation, Tracks, meshes, pack_glb
from echoavatar.files.avatar.halfway import BONES, SOURCES, half
from echoavatar.motion.kinematics import HUMANOID


def test_views_are_aligned_and_hold_the_bytes() -> None:
    buffer = Buffer()
    buffer.add(np.arange(3, dtype=np.uint8))
    index = buffer.add(np.ones((2, 3), np.float32), bounds=True)
    view = buffer.views[buffer.accessors[index]["bufferView"]]
    assert view["byteOffset"] == 4
    assert bytes(buffer.data[4:28]) == np.ones(6, np.float32).tobytes()
    assert buffer.accessors[index]["max"] == [1, 1, 1]


@pytest.mark.parametrize("count", [2, 5])
def test_sparse_bounds_count_the_zeros_only_if_there_are_any(count: int) -> None:
    buffer = Buffer()
    places = buffer.view(np.array([0, 1], np.uint16))
    values = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    accessor = buffer.accessors[buffer.sparse(count, places, values, bounds=True)]
    assert accessor["min"] == ([1, 2, 3] if count == 2 else [0, 0, 0])
    assert accessor["sparse"]["count"] == 2


def test_nothing_that_moves_is_all_zeros() -> None:
    buffer = Buffer()
    accessor = buffer.accessors[buffer.sparse(4, -1, np.zeros((0, 3)), bounds=True)]
    assert "sparse" not in accessor
    assert accessor["max"] == [0, 0, 0]


def test_tracks_share_a_clock_and_integers_are_normalised() -> None:
    tracks = Tracks(Buffer(), 4, 30)
    tracks.add(3, "translation", np.zeros((4, 3)))
    tracks.add(5, "rotation", np.zeros((4, 4), np.int16))
    assert [channel["target"] for channel in tracks.channels] == [
        {"node": 3, "path": "translation"},
        {"node": 5, "path": "rotation"},
    ]
    clock, floats, integers = tracks.buffer.accessors
    assert {sampler["input"] for sampler in tracks.samplers} == {0}
    assert clock["max"] == [pytest.approx(0.1)]
    assert "normalized" not in floats
    assert integers["normalized"]


def test_only_the_face_s_own_vertices_carry_targets() -> None:
    """Each material of the face has its own vertices: together they are those within reach of the shapes."""
    character = load_character()
    buffer = Buffer()
    body, face = meshes(buffer, character)
    counts = [buffer.accessors[primitive["attributes"]["POSITION"]]["count"] for primitive in face["primitives"]]
    on_face = character.triangles[character.triangles[:, 0] < character.face.reach]
    assert sum(counts) == len(np.unique(on_face))
    assert len({primitive["attributes"]["POSITION"] for primitive in body["primitives"]}) == 1


WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
DTYPE = {5126: np.float32, 5121: np.uint8, 5123: np.uint16, 5122: np.int16, 5125: np.uint32}

Wave = Callable[[int], tuple[np.ndarray, np.ndarray]]


def parse(glb: bytes) -> tuple[dict[str, Any], bytes]:
    magic, version, length = struct.unpack_from("<4sII", glb)
    assert (magic, version, length) == (b"glTF", 2, len(glb))
    size, kind = struct.unpack_from("<I4s", glb, 12)
    assert kind == b"JSON"
    assert size % 4 == 0
    binary_size, binary_kind = struct.unpack_from("<I4s", glb, 20 + size)
    assert binary_kind == b"BIN\0"
    assert 28 + size + binary_size == len(glb)
    return json.loads(glb[20 : 20 + size]), glb[28 + size :]


def array(document: dict[str, Any], binary: bytes, index: int) -> np.ndarray:
    """An accessor's values (count, width); sparse ones filled in, normalized ones as they are stored."""
    accessor = document["accessors"][index]
    width, dtype = WIDTH[accessor["type"]], DTYPE[accessor["componentType"]]
    if "bufferView" in accessor:
        values = view(document, binary, accessor["bufferView"], dtype, accessor["count"] * width)
        values = values.reshape(accessor["count"], width)
    else:
        values = np.zeros((accessor["count"], width), dtype)
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        places = view(document, binary, sparse["indices"]["bufferView"], np.uint16, sparse["count"])
        assert (np.diff(places.astype(int)) > 0).all()
        filled = view(document, binary, sparse["values"]["bufferView"], dtype, sparse["count"] * width)
        values[places] = filled.reshape(-1, width)
    if "min" in accessor:
        np.testing.assert_allclose(accessor["min"], values.min(0), rtol=1e-6)
        np.testing.assert_allclose(accessor["max"], values.max(0), rtol=1e-6)
    return values


def view(document: dict[str, Any], binary: bytes, index: int, dtype: Any, count: int) -> np.ndarray:
    stored = document["bufferViews"][index]
    assert stored["byteOffset"] % 4 == 0
    values = np.frombuffer(binary, dtype, count, stored["byteOffset"])
    assert values.nbytes == stored["byteLength"]
    return values


@pytest.fixture(scope="module")
def file(wave: Wave) -> tuple[dict[str, Any], bytes]:
    return parse(pack_glb(load_character(), [GltfAnimation("wave", *wave(30))]))


def test_the_skeleton_has_the_52_vrm_bones_and_undoes_its_rest_pose(file: tuple[dict[str, Any], bytes]) -> None:
    document, binary = file
    names = [node["name"] for node in document["nodes"]]
    assert tuple(names[:52]) == HUMANOID.names
    joints = document["skins"][0]["joints"]
    assert tuple(names[joint] for joint in joints) == BONES
    binds = array(document, binary, document["skins"][0]["inverseBindMatrices"]).reshape(-1, 4, 4)
    world = np.zeros((len(names), 3))
    for parent, node in enumerate(document["nodes"]):
        for child in node.get("children", []):
            world[child] = world[parent] + document["nodes"][child]["translation"]
        if parent == 0:
            root = np.asarray(node["translation"])
    np.testing.assert_allclose(
        binds[:, 3, :3], -(world[joints] + root), atol=1e-5
    )  # column-major: translation in the last row
    mesh_nodes = [i for i, node in enumerate(document["nodes"]) if "mesh" in node]
    assert mesh_nodes == [52, 53]  # outside the joints: body, face


def test_attributes_and_triangles_survive(file: tuple[dict[str, Any], bytes]) -> None:
    """Corners of all triangles of body and face, in metres, are those of the character."""
    document, binary = file
    character = load_character()
    corners, used = [], set()
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            weights = array(document, binary, attributes["WEIGHTS_0"]).astype(int)
            np.testing.assert_array_equal(weights.sum(1), 255)
            indices = array(document, binary, primitive["indices"])[:, 0]
            corners.append(array(document, binary, attributes["POSITION"])[indices])
            used.add(document["materials"][primitive["material"]]["name"])
    mine = character.positions[character.triangles.reshape(-1)]
    together = np.concatenate(corners)
    np.testing.assert_array_equal(np.sort(together, axis=0), np.sort(mine, axis=0))
    assert {"skin", "hair", "eye", "mouth", "cloth"} <= used


def test_outfits_are_variants_of_the_clothes_materials(file: tuple[dict[str, Any], bytes]) -> None:
    """Each outfit gives each piece of clothing a material with the outfit's own picture; nothing else changes."""
    document, outfits = file[0], load_character().outfits
    names = document["extensions"]["KHR_materials_variants"]["variants"]
    assert [each["name"] for each in names] == list(outfits)
    changing = set()
    for primitive in (each for mesh in document["meshes"] for each in mesh["primitives"]):
        if "extensions" not in primitive:
            continue
        changing.add(document["materials"][primitive["material"]]["name"])
        mappings = primitive["extensions"]["KHR_materials_variants"]["mappings"]
        assert [each["variants"] for each in mappings] == [[i] for i in range(len(outfits))]
        surfaces = [document["materials"][each["material"]]["pbrMetallicRoughness"] for each in mappings]
        pictures = [document["textures"][each["baseColorTexture"]["index"]]["name"] for each in surfaces]
        assert pictures == ["outfit", "outfit_1", "outfit_2"]
    assert changing == {"cloth", "trousers", "shoe"}


def test_the_face_has_the_shapes_by_name_on_every_primitive(file: tuple[dict[str, Any], bytes]) -> None:
    """The jaw's target, summed over primitives, moves what the character's own jawOpen moves, as far."""
    document, binary = file
    face = load_character().face
    mesh = document["meshes"][1]
    assert mesh["extras"]["targetNames"] == list(face.names)
    assert len(mesh["weights"]) == 52
    jaw = face.names.index("jawOpen")
    moved = 0
    for primitive in mesh["primitives"]:
        assert len(primitive["targets"]) == 52
        count = document["accessors"][primitive["attributes"]["POSITION"]]["count"]
        for key in ("POSITION", "NORMAL"):
            assert array(document, binary, primitive["targets"][jaw][key]).shape == (count, 3)
        moved += np.abs(array(document, binary, primitive["targets"][jaw]["POSITION"])).sum()
    np.testing.assert_allclose(moved, np.abs(face.moves[face.part(jaw)]).sum(), rtol=5e-4)
    assert all("targets" not in primitive for primitive in document["meshes"][0]["primitives"])


@pytest.mark.parametrize(("compact", "tolerance"), [(False, 1e-6), (True, 3e-3)])
def test_the_face_is_animated_by_one_track(compact: bool, tolerance: float, wave: Wave) -> None:
    face = np.random.default_rng(0).random((30, 52)).astype(np.float32)
    document, binary = parse(pack_glb(load_character(), [GltfAnimation("talk", *wave(30), face=face)], compact=compact))
    animation = document["animations"][0]
    (channel,) = [c for c in animation["channels"] if c["target"]["path"] == "weights"]
    assert document["nodes"][channel["target"]["node"]]["mesh"] == 1
    values = array(document, binary, animation["samplers"][channel["sampler"]]["output"]).astype(float)
    np.testing.assert_allclose(values.reshape(30, 52) / (255 if compact else 1), face, atol=tolerance)


def test_a_face_of_another_length_or_with_nan_is_refused(wave: Wave) -> None:
    bad = np.zeros((10, 52), np.float32)
    with pytest.raises(MotionError, match=r"the face has shape \(10, 52\)"):
        pack_glb(load_character(), [GltfAnimation("talk", *wave(30), face=bad)])
    bad[3, 3] = np.nan
    with pytest.raises(MotionError, match="not finite"):
        pack_glb(load_character(), [GltfAnimation("talk", *wave(10), face=bad)])


@pytest.mark.parametrize(("compact", "tolerance"), [(False, 1e-6), (True, 4e-5)])
def test_the_animation_reads_back(compact: bool, tolerance: float, wave: Wave) -> None:
    rotations, root = wave(30)
    rotations[15:] *= -1  # the same rotations with the other sign: the file must not jump
    document, binary = parse(pack_glb(load_character(), [GltfAnimation("wave", rotations, root)], compact=compact))
    animation = document["animations"][0]
    expected = {joint: rotations[:, joint] for joint in range(HUMANOID.joints)}
    expected |= {node: half(rotations[:, joint]) for node, joint in zip(HALFWAY_NODES, SOURCES, strict=True)}
    assert len(animation["channels"]) == 1 + len(expected)
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        np.testing.assert_allclose(array(document, binary, sampler["input"])[:, 0], np.arange(30) / 30, atol=1e-6)
        values = array(document, binary, sampler["output"]).astype(float)
        joint = channel["target"]["node"]
        if channel["target"]["path"] == "translation":
            np.testing.assert_allclose(values, root, atol=1e-6)
            continue
        values /= 32767 if compact else 1
        same = np.abs(np.einsum("ti,ti->t", values[:, [3, 0, 1, 2]], expected[joint]))
        np.testing.assert_allclose(same, 1, atol=tolerance)
        assert (np.einsum("ti,ti->t", values[1:], values[:-1]) > 0).all()


def test_only_vertex_views_have_targets(file: tuple[dict[str, Any], bytes]) -> None:
    document, _ = file
    animation = document["animations"][0]
    free = {
        document["skins"][0]["inverseBindMatrices"],
        *(s[k] for s in animation["samplers"] for k in ("input", "output")),
    }
    assert all("target" not in document["bufferViews"][document["accessors"][i]["bufferView"]] for i in free)


def test_motion_of_another_rig_or_with_nan_is_refused(wave: Wave) -> None:
    rotations, root = wave(5)
    with pytest.raises(MotionError, match="retarget"):
        pack_glb(load_character(), [GltfAnimation("wave", rotations[:, :20], root)])
    rotations[2, 3, 1] = np.nan
    with pytest.raises(MotionError, match="not finite"):
        pack_glb(load_character(), [GltfAnimation("wave", rotations, root)])
