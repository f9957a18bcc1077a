"""Our own character, written as GLB and read back; the same as VRM 0.x, facing the other way."""

from pathlib import Path

import numpy as np
import pytest
from tests.motion.formats.test_gltf_rig import spoilt

from echoavatar.errors import MotionError
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.gltf import pack_glb
from echoavatar.motion.ik import HandCollisions, measure_body
from echoavatar.motion.ik.skinned import read_skinned
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rigs import bone_map


@pytest.fixture(scope="module")
def glb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "character.glb"
    path.write_bytes(pack_glb(load_character(), []))
    return path


def test_a_glb_gives_the_profile_of_the_mesh_it_was_made_of(glb: Path) -> None:
    character = load_character()
    read = read_skinned(glb)
    rest, bones = read.skeleton.rest_positions.numpy(), bone_map(read.skeleton)
    for bone, joint in bone_map(HUMANOID).items():
        np.testing.assert_allclose(rest[bones[bone]], HUMANOID.rest_positions[joint].numpy(), atol=1e-4)
    np.testing.assert_allclose(read.weights.sum(1), 1, atol=1e-5)
    profile = measure_body(*read)
    wanted = measure_body(HUMANOID, character.positions, character.dense_weights)
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
        (lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]), "without compression"),
        (lambda d: [n.pop("skin", None) for n in d["nodes"]], "no mesh of the file is skinned"),
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


HOSTILE = {
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


@pytest.mark.parametrize("name", HOSTILE)
def test_a_mesh_that_breaks_the_rules_is_one_error_that_names_the_file(glb: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(MotionError, match=r"bad\.glb"):
        read_skinned(spoilt(tmp_path / "bad.glb", glb.read_bytes(), HOSTILE[name]))
