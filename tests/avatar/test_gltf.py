import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echoavatar.avatar import load_character
from echoavatar.avatar.gltf import Animation, pack_glb, write_glb
from echoavatar.errors import MotionError
from echoavatar.kinematics import HUMANOID

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
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    assert view["byteOffset"] % 4 == 0
    values = np.frombuffer(
        binary,
        DTYPE[accessor["componentType"]],
        accessor["count"] * WIDTH[accessor["type"]],
        view["byteOffset"],
    )
    assert values.nbytes == view["byteLength"]
    values = values.reshape(accessor["count"], -1)
    if "min" in accessor:
        np.testing.assert_allclose(accessor["min"], values.min(0), rtol=1e-6)
        np.testing.assert_allclose(accessor["max"], values.max(0), rtol=1e-6)
    return values


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, wave: Wave) -> tuple[dict[str, Any], bytes]:
    path = tmp_path_factory.mktemp("glb") / "wave.glb"
    write_glb(path, load_character(), *wave(30), fps=30, name="wave")
    return parse(path.read_bytes())


def test_the_skeleton_has_the_52_vrm_bones_and_undoes_its_rest_pose(
    file: tuple[dict[str, Any], bytes],
) -> None:
    document, binary = file
    names = [node["name"] for node in document["nodes"]]
    assert tuple(names[:52]) == HUMANOID.names
    binds = array(document, binary, document["skins"][0]["inverseBindMatrices"]).reshape(-1, 4, 4)
    world = np.zeros((52, 3))
    for parent, node in enumerate(document["nodes"]):
        for child in node.get("children", []):
            world[child] = world[parent] + document["nodes"][child]["translation"]
        if parent == 0:
            root = np.asarray(node["translation"])
    np.testing.assert_allclose(
        binds[:, 3, :3], -(world + root), atol=1e-5
    )  # column-major: translation in the last row
    mesh_nodes = [i for i, node in enumerate(document["nodes"]) if "mesh" in node]
    assert mesh_nodes == [52]  # outside the joints


def test_attributes_and_triangles_survive(file: tuple[dict[str, Any], bytes]) -> None:
    document, binary = file
    character = load_character()
    primitives = document["meshes"][0]["primitives"]
    attributes = primitives[0]["attributes"]
    np.testing.assert_array_equal(array(document, binary, attributes["POSITION"]), character.positions)
    np.testing.assert_allclose(array(document, binary, attributes["WEIGHTS_0"]).sum(1), 1, atol=1e-4)
    total = sum(len(array(document, binary, primitive["indices"])) for primitive in primitives)
    assert total == character.triangles.size
    used = {document["materials"][primitive["material"]]["name"] for primitive in primitives}
    assert {"skin", "hair", "eye", "cloth"} <= used


@pytest.mark.parametrize(("compact", "tolerance"), [(False, 1e-6), (True, 4e-5)])
def test_the_animation_reads_back(compact: bool, tolerance: float, wave: Wave) -> None:
    rotations, root = wave(30)
    rotations[15:] *= -1  # the same rotations with the other sign: the file must not jump
    document, binary = parse(
        pack_glb(load_character(), [Animation("wave", rotations, root)], compact=compact)
    )
    animation = document["animations"][0]
    assert len(animation["channels"]) == 53
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        np.testing.assert_allclose(
            array(document, binary, sampler["input"])[:, 0], np.arange(30) / 30, atol=1e-6
        )
        values = array(document, binary, sampler["output"]).astype(float)
        joint = channel["target"]["node"]
        if channel["target"]["path"] == "translation":
            np.testing.assert_allclose(values, root, atol=1e-6)
            continue
        values /= 32767 if compact else 1
        same = np.abs(np.einsum("ti,ti->t", values[:, [3, 0, 1, 2]], rotations[:, joint]))
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


def test_motion_of_another_rig_or_with_nan_is_refused(tmp_path: Path, wave: Wave) -> None:
    rotations, root = wave(5)
    with pytest.raises(MotionError, match="retarget"):
        write_glb(tmp_path / "a.glb", load_character(), rotations[:, :20], root)
    rotations[2, 3, 1] = np.nan
    with pytest.raises(MotionError, match="not finite"):
        write_glb(tmp_path / "a.glb", load_character(), rotations, root)
    assert not (tmp_path / "a.glb").exists()
