"""The user's character with our motion in it, read by the Khronos validator and three.js."""

import json
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.files.exports.readers import node
from tests.motion.formats.test_gltf_rig import spoilt

from echoavatar.errors import MotionError
from echoavatar.files.exports import Take, read_rig
from echoavatar.files.exports.glb_on_rig import face_weights, pack_on_rig
from echoavatar.motion.arkit import ARKIT_NAMES, VRM_NAMES, to_vrm
from echoavatar.motion.formats.gltf_rig import read_gltf_rig

BAD = ("gone", None, -1, 10**9, 1e300, float("nan"), "x", [], {}, [0] * 3, True)
BONES = ("hips", "head", "leftHand", "rightMiddleDistal", "leftToes", "rightFoot")


@pytest.mark.parametrize("kind", ["child", "longarm"])
def test_three_plays_it_and_every_joint_is_where_we_put_it(rigs, short: Take, tmp_path: Path, kind: str) -> None:  # type: ignore[no-untyped-def]
    """Rest rotations, an armature scaled by 0.01 and a character that faces -Z are all respected."""
    rig = read_rig(rigs[kind])
    assert rig.gltf is not None
    moved = rig.retarget(short)
    (tmp_path / "a.glb").write_bytes(pack_on_rig(rig.gltf, moved))
    bones, names = rig.skeleton.config.vrm, rig.skeleton.names
    read = node("read_glb.mjs", tmp_path / "a.glb", *[names[bones[bone]] for bone in BONES])
    assert read["issues"]["numErrors"] == 0, read["issues"]
    places = moved.motion.pose().positions.numpy() * ([-1, 1, -1] if rig.gltf.is_turned else [1, 1, 1])
    for bone in BONES:
        found = np.array(read["places"][names[bones[bone]]])
        np.testing.assert_allclose(found, places[: len(found), bones[bone]], atol=1e-4, err_msg=bone)
    assert short.face is not None
    (weights,) = read["weights"].values()
    wanted = short.face[:, [ARKIT_NAMES.index("jawOpen")]] if kind == "longarm" else to_vrm(short.face)[:, :5]
    np.testing.assert_allclose(weights, wanted[: len(weights)], atol=1e-4)


def test_it_is_still_the_same_character(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs["child"])
    assert rig.gltf is not None
    (tmp_path / "a.vrm").write_bytes(pack_on_rig(rig.gltf, rig.retarget(short)))
    again = read_gltf_rig(tmp_path / "a.vrm")
    assert again.document["meshes"] == rig.gltf.document["meshes"]
    assert again.document["extensions"] == rig.gltf.document["extensions"]
    np.testing.assert_allclose(again.skeleton.rest_positions, read_gltf_rig(rigs["child"]).skeleton.rest_positions)
    assert [animation["name"] for animation in again.document["animations"]] == ["take"]


def test_a_node_with_a_matrix_is_taken_apart(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """glTF does not let a matrix be animated."""
    data = rigs["child"].read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    entry = document["nodes"][0]
    entry["matrix"] = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *entry.pop("translation"), 1]
    del entry["rotation"]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + data[20 + length :]
    (tmp_path / "m.vrm").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    rig = read_rig(tmp_path / "m.vrm")
    assert rig.gltf is not None
    (tmp_path / "out.vrm").write_bytes(pack_on_rig(rig.gltf, rig.retarget(short)))
    node_0 = read_gltf_rig(tmp_path / "out.vrm").document["nodes"][0]
    assert "matrix" not in node_0
    assert node_0["rotation"] == [0, 0, 0, 1]


def test_a_face_goes_to_arkit_names_else_to_vowels_else_nowhere(short: Take) -> None:
    assert short.face is not None
    target = {"POSITION": 0}
    mesh = {"primitives": [{"targets": [target, target]}], "extras": {"targetNames": ["JawOpen", "other"]}}
    plain = {"nodes": [{"mesh": 0}], "meshes": [mesh]}
    weights = face_weights(plain, short.face)[0]
    np.testing.assert_array_equal(weights[:, 0], short.face[:, ARKIT_NAMES.index("jawOpen")])
    assert not weights[:, 1].any()
    bind = {"morphTargetBinds": [{"node": 0, "index": 1, "weight": 0.5}]}
    vrm = {"VRMC_vrm": {"expressions": {"preset": {"aa": bind}}}}
    silent = {"primitives": [{"targets": [target, target]}]}
    weights = face_weights({"nodes": [{"mesh": 0}], "meshes": [silent], "extensions": vrm}, short.face)[0]
    np.testing.assert_allclose(weights[:, 1], 0.5 * to_vrm(short.face)[:, VRM_NAMES.index("aa")], atol=1e-6)
    assert face_weights({"nodes": [{"mesh": 0}], "meshes": [silent]}, short.face) == {}


def test_a_character_in_several_files_is_refused(rigs, short: Take) -> None:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs["child"])
    assert rig.gltf is not None
    rig.gltf.document["buffers"][0]["uri"] = "beside.bin"
    with pytest.raises(MotionError, match="as one"):
        pack_on_rig(rig.gltf, rig.retarget(short))


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every container of a JSON document with each of its keys."""
    for key in list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield value, key
        yield from places(value[key])


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("kind", ["child", "longarm"])
def test_a_document_damaged_anywhere_is_an_error_of_ours_or_none(
    kind: str, rigs: Mapping[str, Path], short: Take, tmp_path: Path
) -> None:
    draw, take = np.random.default_rng(0), Take(short.motion.cut(0, 4), short.face[:4], None)  # type: ignore[index]
    put, refused = read_rig(rigs[kind]).retarget(take), 0
    for _ in range(60):

        def change(document: dict[str, Any]) -> None:
            found = list(places(document))
            holder, key = found[draw.integers(len(found))]
            value = BAD[draw.integers(len(BAD))]
            if value == "gone":
                del holder[key]
            else:
                holder[key] = value

        path = spoilt(tmp_path / rigs[kind].name, rigs[kind].read_bytes(), change)
        try:
            rig = read_rig(path)
            assert rig.gltf is not None
            pack_on_rig(rig.gltf, put)
        except MotionError as error:
            refused += path.name in str(error)
    assert refused > 5
