"""Rigs of characters with rest poses, scales and facings of their own, read as skeletons without."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.files.exports.bodies import CHILD, MIXAMO, child, long_armed

from echoavatar.errors import MotionError
from echoavatar.files.avatar.gltf import container
from echoavatar.motion.formats.gltf_rig import read_gltf_rig
from echoavatar.motion.kinematics import HUMANOID


def test_a_scaled_armature_with_turned_bones_is_read_in_metres(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.glb"
    path.write_bytes(long_armed())
    rig = read_gltf_rig(path)
    assert not rig.is_turned
    assert len(rig.order) == HUMANOID.joints
    bones, rest = rig.skeleton.config.vrm, rig.skeleton.rest_positions.numpy()
    assert rig.skeleton.names[bones["leftHand"]] == MIXAMO["leftHand"]
    arm = np.linalg.norm(rest[bones["leftHand"]] - rest[bones["leftLowerArm"]])
    assert arm == pytest.approx(1.45 * 0.245, abs=1e-4)
    assert rest[bones["leftHand"], 1] < rest[bones["leftUpperArm"], 1] - 0.3  # an A-pose


def test_a_character_that_faces_away_is_turned_round(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.vrm"
    path.write_bytes(child())
    rig = read_gltf_rig(path)
    assert rig.is_turned
    bones, offsets = rig.skeleton.config.vrm, rig.skeleton.offsets.numpy()
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
    "a bone map of nothing": lambda d: d.update(extensions={"VRMC_vrm": {}}),
    "bones of nodes that are not there": lambda d: d.update(
        extensions={"VRMC_vrm": {"humanoid": {"humanBones": {"hips": {"node": 10**9}}}}}
    ),
    "a thumb of no kind": lambda d: d.update(
        extensions={"VRM": {"humanoid": {"humanBones": [{"bone": "leftThumbX", "node": 0}]}}}
    ),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", HOSTILE)
def test_a_document_that_breaks_the_rules_is_one_error_that_names_the_file(tmp_path, name) -> None:  # type: ignore[no-untyped-def]
    path = spoilt(tmp_path / "a.glb", long_armed(), HOSTILE[name])
    with pytest.raises(MotionError, match=r"a\.glb"):
        read_gltf_rig(path)


def test_nested_json_and_lists_are_no_gltf(tmp_path) -> None:  # type: ignore[no-untyped-def]
    for text in (b"[" * 100_000, b"[]  "):
        path = tmp_path / "a.glb"
        path.write_bytes(struct.pack("<4sIIII", b"glTF", 2, 0, len(text), 0x4E4F534A) + text)
        with pytest.raises(MotionError, match="not binary glTF"):
            read_gltf_rig(path)
