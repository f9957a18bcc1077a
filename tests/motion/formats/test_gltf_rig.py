"""Rigs of characters with rest poses, scales and facings of their own, read as skeletons without.

Our own character, written as GLB and read back; the same as VRM 0.x, facing the other way."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.files.avatar.weights import as_skin, humanoid_weights
from tests.files.exports.bodies import CHILD, MIXAMO, child, long_armed

from echoavatar.errors import MotionError
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.gltf import container, pack_glb
from echoavatar.motion.formats.gltf_rig import read_gltf_rig, read_skinned
from echoavatar.motion.ik import HandCollisions, measure_body
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rigs import bone_map


def test_a_scaled_armature_with_turned_bones_is_read_in_metres(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.glb"
    path.write_bytes(long_armed())
    rig = read_gltf_rig(path)
    np.testing.assert_allclose(rig.turn, np.eye(3), atol=1e-6)
    assert len(rig.order) == HUMANOID.joints
    bones, rest = rig.skeleton.config.vrm, rig.skeleton.rest_positions
    assert rig.skeleton.names[bones["leftHand"]] == MIXAMO["leftHand"]
    arm = np.linalg.norm(rest[bones["leftHand"]] - rest[bones["leftLowerArm"]])
    assert arm == pytest.approx(1.45 * 0.245, abs=1e-4)
    assert rest[bones["leftHand"], 1] < rest[bones["leftUpperArm"], 1] - 0.3  # an A-pose


def test_a_character_that_faces_away_is_turned_round(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.vrm"
    path.write_bytes(child())
    rig = read_gltf_rig(path)
    np.testing.assert_allclose(rig.turn, np.diag([-1, 1, -1]), atol=1e-6)
    bones, offsets = rig.skeleton.config.vrm, rig.skeleton.offsets
    assert set(bones) == set(HUMANOID.names)
    for joint, name in enumerate(HUMANOID.names):
        np.testing.assert_allclose(offsets[bones[name]], CHILD[joint], atol=1e-5, err_msg=name)


def spoilt(path: Path, data: bytes, change: Callable[[dict[str, Any]], object]) -> Path:
    """The file with its JSON changed, its binary as it was."""
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    change(document)
    path.write_bytes(container(document, data[28 + length :]))
    return path


def hips(document: dict[str, Any]) -> int:
    return next(k for k, node in enumerate(document["nodes"]) if node.get("name") == "mixamorig:Hips")


def nested(document: dict[str, Any]) -> None:
    for _ in range(2000):
        document["nodes"].append({"children": [len(document["nodes"]) + 1]})
    document["nodes"].append({})


def orphan(document, name):
    """Take the node of this name from its parent."""
    for node in document["nodes"]:
        kept = [child for child in node.get("children", []) if document["nodes"][child].get("name") != name]
        node.update(children=kept)


HOSTILE = {
    "a node that is its own parent": lambda d: d["nodes"][hips(d)]["children"].append(hips(d)),
    "a cycle": lambda d: d["nodes"][-1].setdefault("children", []).append(hips(d)),
    "a child twice": lambda d: d["nodes"][hips(d)]["children"].append(d["nodes"][hips(d)]["children"][0]),
    "a child that is not there": lambda d: d["nodes"][0].setdefault("children", []).append(10**9),
    "a negative child": lambda d: d["nodes"][0].setdefault("children", []).append(-1),
    "a text for a child": lambda d: d["nodes"][0].setdefault("children", []).append("hips"),
    "too deep": nested,
    "too many": lambda d: d["nodes"].extend([{}] * 70_000),
    "no nodes": lambda d: d.pop("nodes"),
    "no joints": lambda d: d["skins"][0].pop("joints"),
    "a joint that is not there": lambda d: d["skins"][0]["joints"].append(10**6),
    "a rotation of three": lambda d: d["nodes"][0].update(rotation=[0, 0, 0]),
    "a matrix of texts": lambda d: d["nodes"][0].update(matrix=["x"] * 16),
    "a place that is not finite": lambda d: d["nodes"][hips(d)].update(translation=[0, float("nan"), 0]),
    "a head that hangs from nothing": lambda d: orphan(d, "mixamorig:Head"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", HOSTILE)
def test_a_document_that_breaks_the_rules_is_one_error_that_names_the_file(tmp_path, name) -> None:  # type: ignore[no-untyped-def]
    path = spoilt(tmp_path / "a.glb", long_armed(), HOSTILE[name])
    with pytest.raises(MotionError, match=r"a\.glb"):
        read_gltf_rig(path)


def vrm1(**bones: object) -> dict[str, Any]:
    return {"VRMC_vrm": {"humanoid": {"humanBones": bones}}}


def vrm0(*bones: dict[str, object]) -> dict[str, Any]:
    return {"VRM": {"humanoid": {"humanBones": bones}}}


@pytest.mark.parametrize(
    "extensions",
    [
        {"VRMC_vrm": {}},
        vrm0(),
        vrm1(hips={"node": 10**9}),
        vrm1(hips={}),
        vrm0({"bone": "leftThumbX", "node": 0}),
        vrm0({"bone": "leftEye", "node": -1}, {"bone": "jaw", "node": None}),
    ],
    ids=str,
)
def test_a_map_without_the_bones_of_a_body_is_completed_by_names(tmp_path: Path, extensions: dict[str, Any]) -> None:
    path = spoilt(tmp_path / "a.vrm", long_armed(), lambda document: document.update(extensions=extensions))
    rig = read_gltf_rig(path).skeleton
    assert {bone: rig.names[joint] for bone, joint in rig.config.vrm.items()} == MIXAMO


def test_a_map_is_believed_where_it_and_the_names_differ(tmp_path: Path) -> None:
    def lower(document: dict[str, Any]) -> None:
        names = [node.get("name") for node in document["nodes"]]
        document["extensions"] = vrm1(chest={"node": names.index("mixamorig:Spine")})

    rig = read_gltf_rig(spoilt(tmp_path / "a.vrm", long_armed(), lower)).skeleton
    assert rig.names[rig.config.vrm["chest"]] == "mixamorig:Spine"


def test_nested_json_and_lists_are_no_gltf(tmp_path) -> None:  # type: ignore[no-untyped-def]
    for text in (b"[" * 100_000, b"[]  "):
        path = tmp_path / "a.glb"
        path.write_bytes(struct.pack("<4sIIII", b"glTF", 2, 0, len(text), 0x4E4F534A) + text)
        with pytest.raises(MotionError, match=r"a\.glb is not"):
            read_gltf_rig(path)


@pytest.fixture(scope="module")
def glb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "character.glb"
    path.write_bytes(pack_glb(load_character(), []))
    return path


def test_a_glb_gives_the_profile_of_the_mesh_it_was_made_of(glb: Path) -> None:
    character = load_character()
    read = read_skinned(glb)
    rest, bones = read.skeleton.rest_positions, bone_map(read.skeleton)
    for bone, joint in bone_map(HUMANOID).items():
        np.testing.assert_allclose(rest[bones[bone]], HUMANOID.rest_positions[joint], atol=1e-4)
    np.testing.assert_allclose(read.weights.shares.sum(1), 1, atol=1e-5)
    profile = measure_body(*read)
    wanted = measure_body(HUMANOID, character.positions, as_skin(humanoid_weights(character)))
    for ours, theirs in zip(profile.parts, wanted.parts, strict=True):
        across = [0, 2]  # how far a slice reaches up and down depends on where a file puts its vertices
        loose = 0.04 if ours.bone == "neck" else 0.012  # so does what counts as the chin's or the neck's
        np.testing.assert_allclose(np.array(ours.radii)[across], np.array(theirs.radii)[across], atol=loose)
        assert abs(ours.radii[1] - theirs.radii[1]) < 0.04
    assert HandCollisions(read.skeleton, profile).is_able


def test_vrm_0_characters_are_turned_round(glb: Path, tmp_path: Path) -> None:
    def turn(document: dict) -> None:  # type: ignore[type-arg]
        bones = [
            {"bone": bone, "node": next(k for k, n in enumerate(document["nodes"]) if n.get("name") == bone)}
            for bone in bone_map(HUMANOID)
            if "Thumb" not in bone
        ]
        document.setdefault("extensions", {})["VRM"] = {"humanoid": {"humanBones": bones}}
        document["extensions"].pop("VRMC_vrm", None)
        hips = next(k for k, n in enumerate(document["nodes"]) if n.get("name") == "hips")
        document["nodes"].append({"name": "turned", "rotation": [0, 1, 0, 0], "children": [hips]})

    read = read_skinned(spoilt(tmp_path / "old.vrm", glb.read_bytes(), turn))
    left = read.skeleton.rest_positions[bone_map(read.skeleton)["leftHand"]]
    assert left[0] > 0.4
    assert read.vertices[:, 1].max() > 1.6


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda d: d.pop("skins"), "has no skin"),
        (lambda d: [n.pop("skin", None) for n in d["nodes"]], "bad.glb: none of its meshes is skinned"),
    ],
)
def test_files_that_do_not_serve_say_why(glb: Path, tmp_path: Path, change, problem: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(MotionError, match=problem):
        read_skinned(spoilt(tmp_path / "bad.glb", glb.read_bytes(), change))


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="check the name"):
        read_skinned(tmp_path / "none.glb")
    (tmp_path / "text.glb").write_text("no glTF")
    with pytest.raises(MotionError, match="not binary glTF"):
        read_skinned(tmp_path / "text.glb")


HOSTILE_MESHES = {
    "a count beyond the file": lambda d: d["accessors"][0].update(count=10**12),
    "a negative count": lambda d: d["accessors"][0].update(count=-1),
    "a stride of nothing": lambda d: [view.update(byteStride=0) for view in d["bufferViews"]],
    "a negative offset": lambda d: [view.update(byteOffset=-4) for view in d["bufferViews"]],
    "one mesh ten thousand times": lambda d: d["nodes"].extend([{"mesh": 0, "skin": 0}] * 10_000),
    "weights of no joint": lambda d: d["skins"][0].update(joints=d["skins"][0]["joints"][:1]),
    "an accessor without a view": lambda d: [accessor.pop("bufferView") for accessor in d["accessors"][:8]],
    "no positions": lambda d: [
        part["attributes"].pop("POSITION") for mesh in d["meshes"] for part in mesh["primitives"]
    ],
}


@pytest.mark.parametrize("name", HOSTILE_MESHES)
def test_a_mesh_that_breaks_the_rules_is_one_error_that_names_the_file(glb: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(MotionError, match=r"bad\.glb"):
        read_skinned(spoilt(tmp_path / "bad.glb", glb.read_bytes(), HOSTILE_MESHES[name]))
