"""The user's character with our motion in it, read by the Khronos validator and three.js.

Retargeting to three bodies of other proportions: feet on the floor, hands that meet."""

import json
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.files.exports.moving import TOUCHES, claps, felt, palms, touching
from tests.files.exports.readers import node
from tests.motion.formats.test_gltf_rig import spoilt

from echoavatar.errors import MotionError
from echoavatar.files.exports import Rig, Take, read_rig, write_take
from echoavatar.files.exports.target_rig import pack_on_rig
from echoavatar.motion.arkit import ARKIT_NAMES, to_vrm
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.formats.gltf_rig import read_gltf_rig
from echoavatar.motion.ik import body_of_rig
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.foot_planting import foot_contacts
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.upright import OURS, Stand
from echoavatar_lab.data.faults import penetration_depth_m

BAD = ("gone", None, -1, 10**9, 1e300, float("nan"), "x", [], {}, [0] * 3, True)
TO_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
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
    places = moved.motion.pose().positions @ rig.gltf.turn
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


KINDS = ("child", "tall", "longarm")
HIPS = {"child": 0.49, "tall": 1.18, "longarm": 0.83}


@pytest.fixture(scope="module", params=KINDS)
def put(request: pytest.FixtureRequest, rigs, take: Take) -> tuple[Rig, Motion]:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs[request.param])
    assert rig.skeleton.rest_positions[0, 1] == pytest.approx(HIPS[request.param], abs=0.01)
    return rig, rig.retarget(take).motion


def feet(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """World places of ankles and toes (t, 2, 2, 3), and their height at rest."""
    bones, rest = bone_map(motion.skeleton), motion.skeleton.rest_positions
    joints = [[bones[f"{side}{part}"] for part in ("Foot", "Toes")] for side in ("left", "right")]
    return motion.pose().positions[:, joints], rest[joints][..., 1]


def test_planted_feet_stand_on_the_floor_and_stay_there(
    put: tuple[Rig, Motion], take: Take, request: pytest.FixtureRequest
) -> None:
    _, motion = put
    contacts = foot_contacts(take.motion)
    assert 0.7 < contacts.mean() < 0.95
    places, rest = feet(motion)
    over = places[..., 1] - rest
    table = {"child": 0.002, "tall": 0.004, "longarm": 0.003}  # docs/integrations/exports.md, to a millimetre
    off = table[request.node.callspec.params["put"]]
    assert np.abs(over[contacts]).max() == pytest.approx(off, abs=6e-4)
    assert over.min() > -0.005
    still = contacts[1:] & contacts[:-1]
    slid = np.linalg.norm(np.diff(places[..., [0, 2]], axis=0), axis=-1)
    assert slid[still].max() < 0.001  # metres between two frames
    assert over.max() > 0.02  # and the others step


def test_palms_that_meet_still_meet(put: tuple[Rig, Motion], take: Take) -> None:
    rig, motion = put
    bones, rest = rig.skeleton.config.vrm, rig.skeleton.rest_positions
    hand = np.linalg.norm(rest[bones["leftMiddleProximal"]] - rest[bones["leftHand"]])
    ours = np.linalg.norm(HUMANOID.offsets[HUMANOID.index("leftMiddleProximal")])
    gap = np.linalg.norm(np.diff(palms(motion), axis=1)[:, 0], axis=-1)
    for moment in claps(take.motion):
        near = gap[max(0, round(moment) - 2) : round(moment) + 3].min()
        assert near == pytest.approx(0.02 * hand / ours, abs=0.005)
    assert gap.max() > 3 * hand


@pytest.mark.parametrize("kind", KINDS)
def test_hands_that_rest_on_the_body_still_do_and_none_is_inside(kind: str, rigs) -> None:  # type: ignore[no-untyped-def]
    """Cheek, hip, belly and heart: each palm near the same place on the same part of another body."""
    rig, source = read_rig(rigs[kind]), touching()
    plain, motion = retarget(source, rig.skeleton), rig.retarget(Take(source, None, None)).motion
    assert penetration_depth_m(rig.skeleton, motion.matrices(), rig.body).max() < 1e-3
    missed, by_rotations_alone = [], []
    for touch in TOUCHES:
        place, _ = felt(source, body_of_rig(HUMANOID), touch)
        for moved, found in ((motion, missed), (plain, by_rotations_alone)):
            there, radii = felt(moved, rig.body, touch)
            found.append(np.linalg.norm((there - place) * radii, axis=-1).max())
    table = {"child": (0.010, 0.132), "tall": (0.011, 0.021), "longarm": (0.015, 0.195)}  # docs/integrations/exports.md
    assert (max(missed), max(by_rotations_alone)) == pytest.approx(table[kind], abs=0.001)


def test_a_body_is_measured_where_there_is_a_mesh(rigs) -> None:  # type: ignore[no-untyped-def]
    child = read_rig(rigs["child"])
    head = next(part for part in child.body.parts if part.bone == "head")
    np.testing.assert_allclose(head.radii, [0.12, 0.165, 0.1425], atol=0.015)  # as large as `bodies` made it
    tall = read_rig(rigs["tall"])
    for part, wanted in zip(tall.body.parts, body_of_rig(tall.skeleton).parts, strict=True):
        np.testing.assert_allclose(part.radii, wanted.radii, rtol=1e-3)


def test_motion_stays_smooth(put: tuple[Rig, Motion], take: Take) -> None:
    """No joint jumps more between frames than 1.8 times what the source's fastest joint does."""
    _, motion = put
    fastest = [
        np.degrees(
            2 * np.arccos(np.clip(np.abs((m.rotations[1:] * m.rotations[:-1]).sum(-1)), 0, 1).astype(np.float64))
        ).max()
        for m in (take.motion, motion)
    ]
    assert fastest[1] < 1.8 * fastest[0]


def test_a_bvh_may_be_in_metres_or_centimetres(rigs, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs["tall"])
    assert rig.stand.metres == 0.01
    still = np.zeros((1, rig.skeleton.joints, 4), np.float32)
    still[..., 0] = 1
    write_bvh(tmp_path / "m.bvh", rig.skeleton, still, np.zeros((1, 3), np.float32), 30, stand=Stand(metres=1.0))
    metres = read_rig(tmp_path / "m.bvh")
    assert metres.stand.metres == 1
    np.testing.assert_allclose(metres.skeleton.rest_positions, rig.skeleton.rest_positions, atol=1e-4)


@pytest.mark.parametrize("metres", [0.01, 1.0, 0.0254])
def test_a_bvh_with_z_up_gets_the_motion_in_its_own_axes_and_unit(metres: float, take: Take, tmp_path: Path) -> None:
    """The file that is written has the rest pose of the rig's; read again, it is the motion on the rig with Y up."""
    stand = Stand(TO_Z_UP.T, TO_Z_UP.T, metres)
    rest, few = Motion.at_rest(HUMANOID), Take(take.motion.cut(0, 20))
    for name, how in (("plain", OURS), ("turned", stand)):
        write_bvh(tmp_path / f"{name}.bvh", HUMANOID, rest.rotations, rest.root, 30, stand=how)
        write_take(tmp_path / f"{name}.out.bvh", few, rig=read_rig(tmp_path / f"{name}.bvh"))
    given, made = ((tmp_path / f"turned{end}.bvh").read_text().split("MOTION")[0] for end in ("", ".out"))
    assert given.split("CHANNELS", 2)[2] == made.split("CHANNELS", 2)[2]
    plain, turned = (read_bvh(tmp_path / f"{name}.out.bvh").pose().positions for name in ("plain", "turned"))
    np.testing.assert_allclose(turned, plain, atol=1e-4)


def test_what_is_no_rig_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.fbx").write_bytes(b"")
    with pytest.raises(MotionError, match="not a rig"):
        read_rig(tmp_path / "a.fbx")
    with pytest.raises(MotionError, match="cannot be read"):
        read_rig(tmp_path / "none.vrm")
    config = HUMANOID.config
    folded = config.model_copy(
        update={"offsets": tuple((float(np.linalg.norm(at)), 0.0, 0.0) for at in config.offsets)}
    )
    still = Motion.at_rest(type(HUMANOID)(folded))
    write_bvh(tmp_path / "folded.bvh", still.skeleton, still.rotations, still.root, 30)
    with pytest.raises(MotionError, match="stand"):
        read_rig(tmp_path / "folded.bvh")
    crouching = dict(zip(HUMANOID.names, HUMANOID.config.offsets, strict=True))
    for side in ("left", "right"):
        crouching[f"{side}LowerLeg"], crouching[f"{side}Foot"] = (0, 0.41, 0.05), (0, 0.42, 0.05)
    config = HUMANOID.config.model_copy(update={"offsets": tuple(crouching.values())})
    still = Motion.at_rest(HUMANOID).rotations
    write_bvh(tmp_path / "feet_up.bvh", Skeleton(config), still, np.zeros((1, 3), np.float32), 30)
    with pytest.raises(MotionError, match=r"feet_up\.bvh: .*stands or sits"):
        read_rig(tmp_path / "feet_up.bvh")
