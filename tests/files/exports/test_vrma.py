"""VRM animations, read by @pixiv/three-vrm-animation and played on an avatar by three-vrm."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.readers import node

from echoavatar.errors import MotionError
from echoavatar.files.exports import Take, read_rig
from echoavatar.files.exports.formats import write_take
from echoavatar.files.exports.vrma import PRESETS, pack_vrma
from echoavatar.motion.arkit import ARKIT_NAMES, to_vrm
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.retarget import plain_rig


def document(data: bytes) -> dict:  # type: ignore[type-arg]
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])  # type: ignore[no-any-return]


def test_the_file_is_what_the_format_asks_for(short: Take) -> None:
    made = document(pack_vrma(short))
    extension = made["extensions"]["VRMC_vrm_animation"]
    assert extension["specVersion"] == "1.0"
    assert len(extension["humanoid"]["humanBones"]) == 52
    paths = [(c["target"]["node"], c["target"]["path"]) for c in made["animations"][0]["channels"]]
    assert [node for node, path in paths if path == "translation" and node < 52] == [0]  # only the hips travel
    assert not any(path == "scale" for _, path in paths)
    assert not any("rotation" in entry for entry in made["nodes"][:52])  # a T-pose


def test_three_vrm_animation_reads_body_face_and_gaze(short: Take, tmp_path: Path) -> None:
    (tmp_path / "a.vrma").write_bytes(pack_vrma(short))
    read = node("read_vrma.mjs", tmp_path / "a.vrma")
    assert read["duration"] == pytest.approx(44 / 30)
    assert set(read["rotations"]) == set(HUMANOID.names)
    assert set(read["rotations"].values()) == {45}
    assert read["translations"] == ["hips"]
    np.testing.assert_allclose(read["hips"], short.motion.root[0], atol=1e-6)
    assert short.face is not None
    vowels = to_vrm(short.face)
    for k, name in enumerate(PRESETS):
        np.testing.assert_allclose(read["preset"][name], vowels[:, k], atol=1e-6)
    for k, name in enumerate(ARKIT_NAMES):
        np.testing.assert_allclose(read["custom"][name], short.face[:, k], atol=1e-6)
    assert read["looks"] == 45


def test_the_face_is_written_for_the_expressions_that_an_avatar_has(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Its own jaw, in its own spelling, beside a vowel that it then does not need, and a mood."""
    rig = read_rig(rigs["child"])
    assert rig.gltf is not None
    assert short.face is not None
    groups = rig.gltf.document["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"]
    for group, (preset, name) in zip(
        groups,
        [("a", "A"), ("unknown", "Jaw_Open"), ("unknown", "mouth_pucker"), ("joy", "Joy"), ("lookleft", "LookLeft")],
        strict=True,
    ):
        group |= {"presetName": preset, "name": name}
    write_take(tmp_path / "a.vrma", short, rig=rig)
    read = node("read_vrma.mjs", tmp_path / "a.vrma")
    assert set(read["preset"]) == {"happy"}
    assert set(read["custom"]) == {"Jaw_Open", "mouth_pucker"}
    np.testing.assert_allclose(read["custom"]["Jaw_Open"], short.face[:, ARKIT_NAMES.index("jawOpen")], atol=1e-6)
    rig.gltf.document["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"] = [{"binds": [7]}]
    with pytest.raises(MotionError, match=r"child\.vrm"):
        write_take(tmp_path / "a.vrma", short, rig=rig)


def test_on_an_avatar_in_three_vrm_every_joint_is_where_we_put_it(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """The child is a VRM 0.x: it faces the other way, and the player mirrors for it."""
    rig = read_rig(rigs["child"])
    moved = rig.retarget(short)
    (tmp_path / "a.vrma").write_bytes(pack_vrma(moved))
    read = node("read_vrma.mjs", tmp_path / "a.vrma", rigs["child"])
    places, bones = moved.motion.pose().positions, rig.skeleton.config.vrm
    for bone, found in read["places"].items():
        theirs = np.array(found) * [-1, 1, -1]
        np.testing.assert_allclose(theirs, places[: len(theirs), bones[bone]], atol=1e-4, err_msg=bone)


def test_a_rig_at_rest_in_another_pose_is_written_in_t_pose(rigs, short: Take) -> None:  # type: ignore[no-untyped-def]
    moved = read_rig(rigs["longarm"]).retarget(short).motion
    posed = plain_rig(moved.skeleton).of_own(moved)
    bones = posed.skeleton.config.vrm
    np.testing.assert_allclose(posed.pose().positions, moved.pose().positions, atol=1e-5)
    rest = posed.skeleton.rest_positions
    arm = rest[bones["leftHand"]] - rest[bones["leftUpperArm"]]
    assert arm[0] > 0.99 * np.linalg.norm(arm)
    assert rest[bones["leftHand"], 1] > read_rig(rigs["longarm"]).skeleton.rest_positions[bones["leftHand"], 1] + 0.2


def test_eyes_are_no_bones_there(short: Take) -> None:
    """The gaze has a node of its own, and the format forbids both."""
    config = HUMANOID.config
    eyes = {"leftEye": HUMANOID.joints, "rightEye": HUMANOID.joints + 1}
    head = HUMANOID.index("head")
    rig = SkeletonConfig(
        names=(*config.names, *eyes),
        parents=(*config.parents, head, head),
        offsets=(*config.offsets, (0.03, 0.07, 0.07), (-0.03, 0.07, 0.07)),
        vrm=config.vrm | eyes,
    )
    still = np.zeros((short.motion.frames, 2, 4), np.float32)
    still[..., 0] = 1
    motion = Motion(Skeleton(rig), np.concatenate([short.motion.rotations, still], 1), short.motion.root, 30.0)
    bones = document(pack_vrma(Take(motion)))["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
    assert set(bones) == set(config.names)


def test_a_rig_without_a_spine_is_refused(short: Take) -> None:
    names = [name for name in HUMANOID.names if name not in ("spine", "chest", "upperChest")]
    kept = [HUMANOID.index(name) for name in names]
    parents = [-1 if not k else max(0, names.index(_above(name, names))) for k, name in enumerate(names)]
    config = SkeletonConfig(
        names=tuple(names),
        parents=tuple(parents),
        offsets=tuple(HUMANOID.config.offsets[k] for k in kept),
        vrm={name: k for k, name in enumerate(names)},
    )
    motion = Motion(Skeleton(config), short.motion.rotations[:, kept], short.motion.root, 30.0)
    with pytest.raises(MotionError, match="spine"):
        pack_vrma(Take(motion))


def _above(name: str, names: list[str]) -> str:
    parent = HUMANOID.parents[HUMANOID.index(name)]
    while HUMANOID.names[parent] not in names:
        parent = HUMANOID.parents[parent]
    return HUMANOID.names[parent]
