"""Retargeting to three bodies of other proportions: feet on the floor, hands that meet."""

from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.moving import TOUCHES, claps, felt, touching

from echoavatar.errors import MotionError
from echoavatar.files.exports import Rig, Take, read_rig
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.ik import body_of_rig, penetration_depth_m
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.foot_planting import foot_contacts
from echoavatar.motion.kinematics.hand_contact import palms
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rigs import bone_map

KINDS = ("child", "tall", "longarm")
HIPS = {"child": 0.49, "tall": 1.18, "longarm": 0.83}


@pytest.fixture(scope="module", params=KINDS)
def put(request: pytest.FixtureRequest, rigs, take: Take) -> tuple[Rig, Motion]:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs[request.param])
    assert rig.skeleton.rest_positions[0, 1] == pytest.approx(HIPS[request.param], abs=0.01)
    return rig, rig.retarget(take).motion


def feet(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """World places of ankles and toes (t, 2, 2, 3), and their height at rest."""
    bones, rest = bone_map(motion.skeleton), motion.skeleton.rest_positions.numpy()
    joints = [[bones[f"{side}{part}"] for part in ("Foot", "Toes")] for side in ("left", "right")]
    return motion.pose().positions.numpy()[:, joints], rest[joints][..., 1]


def test_planted_feet_stand_on_the_floor_and_stay_there(put: tuple[Rig, Motion], take: Take) -> None:
    _, motion = put
    contacts = foot_contacts(take.motion)
    assert 0.7 < contacts.mean() < 0.95
    places, rest = feet(motion)
    over = places[..., 1] - rest
    assert np.abs(over[contacts]).max() < 0.005
    assert over.min() > -0.005
    still = contacts[1:] & contacts[:-1]
    slid = np.linalg.norm(np.diff(places[..., [0, 2]], axis=0), axis=-1)
    assert slid[still].max() < 0.001  # metres between two frames
    assert over.max() > 0.02  # and the others step


def test_palms_that_meet_still_meet(put: tuple[Rig, Motion], take: Take) -> None:
    rig, motion = put
    bones, rest = rig.skeleton.config.vrm, rig.skeleton.rest_positions.numpy()
    hand = np.linalg.norm(rest[bones["leftMiddleProximal"]] - rest[bones["leftHand"]])
    ours = np.linalg.norm(HUMANOID.offsets[HUMANOID.index("leftMiddleProximal")].numpy())
    gap = np.linalg.norm(np.diff(palms(motion).numpy(), axis=1)[:, 0], axis=-1)
    for moment in claps(take.motion):
        near = gap[max(0, round(moment) - 2) : round(moment) + 3].min()
        assert near == pytest.approx(0.02 * hand / ours, abs=0.005)
    assert gap.max() > 3 * hand


@pytest.mark.parametrize("kind", KINDS)
def test_hands_that_rest_on_the_body_still_do_and_none_is_inside(kind: str, rigs) -> None:  # type: ignore[no-untyped-def]
    """Cheek, hip, belly and heart: each palm within 2 cm of the same place on the same part of another body."""
    rig, source = read_rig(rigs[kind]), touching()
    plain, motion = retarget(source, rig.skeleton), rig.retarget(Take(source, None, None)).motion
    assert penetration_depth_m(rig.skeleton, motion.matrices(), rig.body).max() < 1e-3
    missed, by_rotations_alone = [], []
    for touch in TOUCHES:
        place, _ = felt(source, body_of_rig(HUMANOID), touch)
        for moved, found in ((motion, missed), (plain, by_rotations_alone)):
            there, radii = felt(moved, rig.body, touch)
            found.append(np.linalg.norm((there - place) * radii, axis=-1).max())
    assert max(missed) < 0.02
    assert max(by_rotations_alone) > {"child": 0.10, "tall": 0.018, "longarm": 0.15}[kind]


def test_a_body_is_measured_where_there_is_a_mesh(rigs) -> None:  # type: ignore[no-untyped-def]
    child = read_rig(rigs["child"])
    head = next(part for part in child.body.parts if part.bone == "head")
    np.testing.assert_allclose(head.radii, [0.12, 0.165, 0.1425], atol=0.015)  # as large as `bodies` made it
    assert read_rig(rigs["tall"]).body == body_of_rig(read_rig(rigs["tall"]).skeleton)


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
    assert rig.units_per_metre == pytest.approx(100)
    still = np.zeros((1, rig.skeleton.joints, 4), np.float32)
    still[..., 0] = 1
    write_bvh(tmp_path / "m.bvh", rig.skeleton, still, np.zeros((1, 3), np.float32), 30, scale=1.0)
    metres = read_rig(tmp_path / "m.bvh")
    assert metres.units_per_metre == 1
    np.testing.assert_allclose(metres.skeleton.rest_positions, rig.skeleton.rest_positions, atol=1e-4)


def test_what_is_no_rig_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.fbx").write_bytes(b"")
    with pytest.raises(MotionError, match="not a rig"):
        read_rig(tmp_path / "a.fbx")
    with pytest.raises(MotionError, match="cannot be read"):
        read_rig(tmp_path / "none.vrm")
    lying = HUMANOID.config.model_copy(update={"offsets": tuple((x, z, y) for x, y, z in HUMANOID.config.offsets)})
    still = np.zeros((1, HUMANOID.joints, 4), np.float32)
    still[..., 0] = 1
    write_bvh(tmp_path / "lying.bvh", type(HUMANOID)(lying), still, np.zeros((1, 3), np.float32), 30)
    with pytest.raises(MotionError, match="stand"):
        read_rig(tmp_path / "lying.bvh")
