"""Rigs that names and shape do not tell: the user's map does. And two bodies in one GLB."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.bodies import MIXAMO, long_armed
from tests.motion.formats.test_gltf_rig import spoilt
from tests.motion.kinematics.samples import chain, swaying

from echoavatar.cli import main
from echoavatar.errors import MotionError
from echoavatar.files.exports import read_rig, read_take
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.formats.gltf_rig import read_gltf_rig
from echoavatar.motion.formats.joint_map import map_of, read_map
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.rigs import BONES, UnknownRigError, bone_map, with_bones

PUZZLING = {name: f"n{k}" for k, name in enumerate(MIXAMO.values())}  # joint of Mixamo to a name that says nothing
GIVEN = {bone: PUZZLING[joint] for bone, joint in MIXAMO.items()}


def puzzle(document):
    """Names that say nothing, and legs so unequal that the shape says nothing either."""
    for node in document["nodes"]:
        if node.get("name") == "mixamorig:LeftLeg":
            node["translation"] = [1.6 * x for x in node["translation"]]
        node["name"] = PUZZLING.get(node.get("name"), node.get("name", ""))


@pytest.fixture
def glb(tmp_path: Path) -> Path:
    return spoilt(tmp_path / "puzzle.glb", long_armed(), puzzle)


@pytest.fixture
def bvh(tmp_path: Path) -> Path:
    names = tuple(f"j{k}" for k in range(HUMANOID.joints))
    offsets = np.array(HUMANOID.config.offsets)
    offsets[HUMANOID.index("leftLowerLeg")] *= 1.6
    rig = Skeleton(
        HUMANOID.config.model_copy(
            update={"names": names, "vrm": {}, "tips": {}, "offsets": tuple(map(tuple, offsets.tolist()))}
        )
    )
    motion = swaying(20, size=0.1)
    write_bvh(tmp_path / "clip.bvh", rig, motion.rotations, motion.root, 30.0)
    return tmp_path / "clip.bvh"


def written(path: Path, given: object) -> Path:
    path.write_text(given if isinstance(given, str) else json.dumps(given), encoding="utf-8")
    return path


def test_a_glb_that_nothing_tells_is_read_by_a_map(glb: Path, tmp_path: Path) -> None:
    with pytest.raises(
        UnknownRigError, match=r"puzzle\.glb: the rig is not known: no joint is hips.*not placed: .*n1.*--map"
    ):
        read_gltf_rig(glb)
    rig = read_gltf_rig(glb, read_map(written(tmp_path / "map.json", GIVEN)))
    assert {bone: rig.skeleton.names[joint] for bone, joint in rig.skeleton.config.vrm.items()} == GIVEN
    assert read_rig(glb, GIVEN).skeleton.config.vrm == rig.skeleton.config.vrm


def test_a_bvh_that_nothing_tells_is_read_by_a_map(bvh: Path) -> None:
    given = {bone: f"j{joint}" for bone, joint in HUMANOID.config.vrm.items()}
    with pytest.raises(UnknownRigError):
        bone_map(read_bvh(bvh).skeleton)
    assert bone_map(read_bvh(bvh, given).skeleton) == HUMANOID.config.vrm
    assert bone_map(read_take(bvh, given).on_humanoid().motion.skeleton) == HUMANOID.config.vrm
    assert read_rig(bvh, given).skeleton.config.vrm == HUMANOID.config.vrm


def test_a_map_comes_before_names_and_null_is_no_bone(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(long_armed())
    given = {"chest": "mixamorig:Spine2", "upperChest": None, "leftToes": None}
    bones = read_gltf_rig(path, given).skeleton
    found = {bone: bones.names[joint] for bone, joint in bones.config.vrm.items()}
    wanted = {bone: joint for bone, joint in MIXAMO.items() if bone not in ("upperChest", "leftToes")}
    assert found == wanted | {"chest": "mixamorig:Spine2"}


def test_a_map_also_mends_what_a_vrm_says_of_itself(tmp_path: Path) -> None:
    def wrong(document):
        nodes = {node.get("name"): k for k, node in enumerate(document["nodes"])}
        bones = {bone: {"node": nodes[joint]} for bone, joint in MIXAMO.items()} | {
            "head": {"node": nodes["mixamorig:Neck"]}
        }
        document["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": bones}}}

    path = spoilt(tmp_path / "a.vrm", long_armed(), wrong)
    rig = read_gltf_rig(path, {"head": "mixamorig:Head"}).skeleton
    assert rig.names[rig.config.vrm["head"]] == "mixamorig:Head"


def test_a_clip_without_hands_may_be_mapped() -> None:
    """The tips of its forearms are its hands."""
    body = [
        bone for bone in HUMANOID.names if not bone.endswith(("Hand", "Proximal", "Intermediate", "Distal", "carpal"))
    ]
    keep = [HUMANOID.index(bone) for bone in body]
    config = HUMANOID.config.model_copy(
        update={
            "names": tuple(f"j{k}" for k in range(len(keep))),
            "parents": tuple(-1 if HUMANOID.parents[k] < 0 else keep.index(HUMANOID.parents[k]) for k in keep),
            "offsets": tuple(HUMANOID.config.offsets[k] for k in keep),
            "parts": {}, "mirror": (), "feet": (), "vrm": {},
            "tips": {f"j{body.index(f'{side}LowerArm')}": (0.1, 0.0, 0.0) for side in ("left", "right")},
        }
    )  # fmt: skip
    still = swaying(4)
    motion = Motion(Skeleton(config), still.rotations[:, keep], still.root, 30.0)
    given = {bone: f"j{k}" for k, bone in enumerate(body)}
    assert with_bones(motion.skeleton, given).config.vrm == {bone: k for k, bone in enumerate(body)}
    with pytest.raises(UnknownRigError, match="no joint is leftFoot;"):
        with_bones(motion.skeleton, given | {"leftFoot": None})


HOSTILE = {
    "no JSON": ("{", "is not JSON"),
    "a list": ("[]", "not a JSON object"),
    "no text": ('{"hips": 3}', "hips is 3; write the name of a joint, or null"),
    "a list of joints": ('{"hips": ["a", "b"]}', "hips is .*; write the name of a joint"),
    "an unknown bone": ('{"tail": "a"}', "'tail' is no bone"),
    "other case": ('{"Hips": "a"}', "'Hips' is no bone"),
    "one joint twice": ('{"hips": "a", "spine": "a"}', "'a' is both hips and spine; keep one"),
    "too deep": ("[" * 100_000, "map.json"),
    "not a number": ('{"hips": NaN}', "is not JSON"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_map_is_one_line_that_names_the_file(name: str, tmp_path: Path) -> None:
    text, problem = HOSTILE[name]
    with pytest.raises(MotionError, match=problem) as caught:
        read_map(written(tmp_path / "map.json", text))
    assert "map.json" in str(caught.value)
    assert len(str(caught.value)) < 600


def test_a_map_of_joints_that_are_not_there_is_refused(tmp_path: Path, glb: Path) -> None:
    with pytest.raises(
        MotionError, match=r"the map says that hips is 'Hüfte', and the rig has no such joint; correct it"
    ):
        read_gltf_rig(glb, {"hips": "Hüfte"})
    with pytest.raises(MotionError, match="no such joint"):
        with_bones(chain((0, 1, 0), (0, 1, 0)), {"hips": "joint7"})
    with pytest.raises(MotionError, match="does not exist; check the name"):
        read_map(tmp_path / "none.json")
    assert read_map(None) is None


def test_a_map_whose_bones_do_not_hang_from_the_hips_is_refused(glb: Path) -> None:
    with pytest.raises(MotionError, match="does not hang from its hips"):
        read_gltf_rig(glb, GIVEN | {"hips": GIVEN["spine"], "spine": None})


def test_the_template_holds_what_was_found_and_null_for_the_rest(glb: Path, bvh: Path, tmp_path: Path) -> None:
    known = tmp_path / "known.glb"
    known.write_bytes(long_armed())
    assert map_of(known) == {bone: MIXAMO.get(bone) for bone in BONES}
    assert map_of(glb) == map_of(bvh) == dict.fromkeys(BONES)
    half = spoilt(tmp_path / "half.glb", long_armed(), without_a_knee)
    assert [bone for bone, joint in map_of(half).items() if joint is None] == ["leftLowerLeg", *BONES[-3:]]
    assert map_of(half)["rightLowerLeg"] == "mixamorig:RightLeg"
    clip = spoilt(tmp_path / "clip.glb", long_armed(), lambda document: document.pop("skins"))
    assert map_of(clip) == map_of(known)


def without_a_knee(document):
    """One name says nothing, and the legs are so unequal that their shape says nothing."""
    node = next(node for node in document["nodes"] if node.get("name") == "mixamorig:LeftLeg")
    node |= {"name": "?", "translation": [1.6 * x for x in node["translation"]]}


def test_the_command_writes_a_template_and_takes_the_completed_map(
    glb: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    template = tmp_path / "map.json"
    assert main(["rig", str(glb), "-o", str(tmp_path / "body.json")]) == 1
    error = capsys.readouterr().err
    assert "--map FILE" in error
    assert error.count("\n") == 1
    assert main(["rig", "--template", str(glb), "-o", str(template)]) == 0
    assert "55 of 55 bones were not found" in capsys.readouterr().out
    assert main(["rig", str(glb), "--template"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(template.read_text()) == dict.fromkeys(BONES)
    written(template, json.loads(template.read_text()) | GIVEN)
    assert main(["rig", str(glb), "--map", str(template), "-o", str(tmp_path / "body.json")]) == 0
    assert (tmp_path / "body.json").exists()
    assert main(["rig", str(glb)]) == 1
    assert "-o FILE.json" in capsys.readouterr().err


def test_export_takes_a_map_for_the_rig_or_for_the_clip(
    glb: Path, bvh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    of_rig = written(tmp_path / "rig.json", GIVEN)
    of_clip = written(tmp_path / "clip.json", {bone: f"j{joint}" for bone, joint in HUMANOID.config.vrm.items()})
    out = tmp_path / "out.glb"
    assert main(["export", str(bvh), "-o", str(tmp_path / "ours.bvh"), "--map", str(of_clip)]) == 0
    assert main(["export", str(bvh), "-o", str(tmp_path / "ours.npz")]) == 0
    assert main(["export", str(bvh), "-o", str(tmp_path / "ours.vrma"), "--map", str(of_clip)]) == 0
    assert main(["export", str(bvh), "-o", str(tmp_path / "ours.vrma")]) == 1
    write_bvh(tmp_path / "own.bvh", HUMANOID, swaying(5).rotations, swaying(5).root, 30.0)
    assert main(["export", str(tmp_path / "own.bvh"), "-o", str(out), "--rig", str(glb), "--map", str(of_rig)]) == 0
    assert read_gltf_rig(out, GIVEN).document["animations"][0]["channels"]
    capsys.readouterr()
    assert main(["export", str(tmp_path / "ours.npz"), "-o", str(out), "--map", str(of_rig)]) == 1
    assert "a map is for a BVH or a rig" in capsys.readouterr().err


def chair(document):
    """A second skin, of a chair whose joints have names of a body's."""
    first = len(document["nodes"])
    names = ("Hips", "LeftUpLeg", "RightUpLeg", "LeftFoot", "Head")
    document["nodes"] += [{"name": name, "translation": [1.0, 0.1 * k, 0.0]} for k, name in enumerate(names)]
    document["nodes"][first]["children"] = list(range(first + 1, first + len(names)))
    document["skins"].insert(0, {"joints": list(range(first, first + len(names)))})
    for node in document["nodes"]:
        if "skin" in node:
            node["skin"] += 1


def controls(document):
    """A rig of controls with the names of the bones, which no skin uses, before all others."""
    first = len(document["nodes"])
    names = [name.removeprefix("mixamorig:") for name in MIXAMO.values()]
    document["nodes"] += [{"name": name} for name in names]
    for k, parent in enumerate(HUMANOID.parents[1:], start=1):
        document["nodes"][first + parent].setdefault("children", []).append(first + k)
    document["scenes"][0]["nodes"].insert(0, first)


@pytest.mark.parametrize("other", [chair, controls])
def test_another_skeleton_with_hips_beside_the_character_confuses_nothing(tmp_path: Path, other) -> None:
    path = spoilt(tmp_path / "a.glb", long_armed(), other)
    rig = read_gltf_rig(path).skeleton
    assert {bone: rig.names[joint] for bone, joint in rig.config.vrm.items()} == MIXAMO
    assert rig.joints == len(MIXAMO)


def test_bones_that_are_found_by_shape_animate_a_glb(tmp_path: Path) -> None:
    def nameless(document):
        for node in document["nodes"]:
            node.pop("name", None)

    path, plain = spoilt(tmp_path / "nameless.glb", long_armed(), nameless), tmp_path / "plain.glb"
    plain.write_bytes(long_armed())
    assert read_gltf_rig(path).skeleton.config.vrm == read_gltf_rig(plain).skeleton.config.vrm
