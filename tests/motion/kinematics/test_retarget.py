"""Retargeting: a rig to itself, to a taller one, and the recorded rigs to ours.

A stream of frames on another rig: against the retargeting of whole clips, and against plain expectations."""

import numpy as np
import pytest
from tests.motion.kinematics.samples import chain, matrix_from_euler, recorded, swaying
from tests.motion.kinematics.test_foot_planting import FEET, REST, standing
from tests.motion.stages.test_modes import walking

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig, forward_kinematics
from echoavatar.motion.kinematics.foot_planting import planted
from echoavatar.motion.kinematics.retarget import LiveRetarget, leg_length, retarget
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_axis_angle, quaternion_from_matrix, unit
from echoavatar_lab.data.faults import skate

LIMBS = [
    (f"{side}{a}", f"{side}{b}")
    for side in ("left", "right")
    for a, b in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot"))
]
RECORDED = {
    "talk": "motion_permissive/hifi_apache2/talk.bvh",
    "rocketbox": "motion_permissive/movebox_rocketbox_mit/rb_idle_neutral.bvh",
    "mesh2motion": "motion_permissive/mesh2motion_cc0/reject.bvh",
    "zeroeggs": "motion_eval_only/zeroeggs_cc_by_nc_nd/067_Speech_2_x_1_0.bvh",
    "bandai": "motion_eval_only/bandai_namco_cc_by_nc/dataset-1/dataset-1_dance-short_normal_001.bvh",
}


def directions(motion: Motion, bones: dict[str, int]) -> np.ndarray:
    places = motion.pose().positions
    pairs = [(bones[a], bones[b]) for a, b in LIMBS]
    return unit(np.stack([places[:, b] - places[:, a] for a, b in pairs], 1))


def test_a_rig_to_itself_changes_nothing():
    motion = standing(10)
    back = retarget(motion, has_footing=False)
    np.testing.assert_allclose(back.matrices(), motion.matrices(), atol=1e-5, rtol=0)
    np.testing.assert_allclose(back.root, motion.root, atol=2e-3)


def test_a_taller_rig_travels_further():
    offsets = tuple((1.2 * x, 1.2 * y, 1.2 * z) for x, y, z in HUMANOID.config.offsets)
    tall = Skeleton(HUMANOID.config.model_copy(update={"offsets": offsets}))
    motion = swaying(20, size=0.0)
    moved = retarget(motion, tall, has_footing=False)
    assert leg_length(tall, tall.config.vrm) == pytest.approx(1.2 * leg_length(HUMANOID, HUMANOID.config.vrm))
    np.testing.assert_allclose(np.diff(moved.root, axis=0), 1.2 * np.diff(motion.root, axis=0), atol=1e-5)
    np.testing.assert_allclose(moved.matrices(), motion.matrices(), atol=1e-5, rtol=0)


@pytest.mark.parametrize("name", RECORDED)
def test_limbs_of_recorded_rigs_point_where_they_pointed(name):
    """Mean angle between the bones' directions, before footing, in degrees."""
    motion = read_bvh(recorded(RECORDED[name]))
    motion = motion.cut(0, min(motion.frames, 300))
    moved = retarget(motion, has_footing=False)
    ours = directions(moved, bone_map(HUMANOID))
    theirs = directions(motion, bone_map(motion.skeleton))
    angles = np.degrees(np.arccos(np.clip((ours * theirs).sum(-1), -1, 1)))
    assert float(angles.mean()) < 0.5


@pytest.mark.parametrize("name", ["talk", "rocketbox", "mesh2motion"])
def test_standing_feet_stand_on_the_floor_and_still(name):
    motion = read_bvh(recorded(RECORDED[name]))
    feet = retarget(motion).pose().positions[:, FEET]
    assert skate(feet, 30, standing_height=REST) < 0.1
    np.testing.assert_allclose(feet[..., 1], np.tile(REST, (motion.frames, 1)), atol=5e-3)


def test_bones_nobody_drives_stay_or_share():
    """Bandai-Namco has no fingers and one spine bone less: fingers rest, and a chest between two turns half-way."""
    motion = read_bvh(recorded(RECORDED["bandai"]), {"upperChest": "Chest", "chest": None}).cut(0, 60)
    moved = retarget(motion, has_footing=False)
    fingers = moved.rotations[:, list(HUMANOID.config.parts["hands"])]
    np.testing.assert_allclose(np.abs(fingers[..., 0]), 1.0, atol=1e-5)
    chest, upper = (moved.rotations[:, HUMANOID.index(name)] for name in ("chest", "upperChest"))
    np.testing.assert_allclose(np.abs((chest * upper).sum(-1)), 1.0, atol=1e-4)


def test_an_unknown_rig_is_explained():
    motion = swaying(4, skeleton=chain((0, 1, 0), (0, 1, 0)))
    with pytest.raises(MotionError, match="is not known"):
        retarget(motion)


def rig(*, leg: float, arm: float, trunk: float) -> Skeleton:
    """Our rig with other proportions, its balls 2 cm over the floor as ours are."""
    scale = {"LowerLeg": leg, "Foot": leg, "LowerArm": arm, "Hand": arm}
    offsets = []
    for name, offset in zip(HUMANOID.names, HUMANOID.config.offsets, strict=True):
        bone = name.removeprefix("left").removeprefix("right")
        offsets.append([c * scale.get(bone, 1.0 if "Toes" in name else trunk) for c in offset])
    built = Skeleton(HUMANOID.config.model_copy(update={"offsets": tuple(map(tuple, offsets))}))
    offsets[0][1] += 0.02 - float(built.rest_positions[FEET, 1].min())
    return Skeleton(HUMANOID.config.model_copy(update={"offsets": tuple(map(tuple, offsets))}))


@pytest.mark.parametrize(
    "proportions",
    [
        pytest.param({"leg": 0.55, "arm": 0.6, "trunk": 0.7}, id="child"),
        pytest.param({"leg": 1.25, "arm": 1.1, "trunk": 1.05}, id="tall"),
        pytest.param({"leg": 0.8, "arm": 1.5, "trunk": 1.0}, id="long-armed"),
    ],
)
def test_walkers_of_other_proportions_stand_on_the_floor(proportions):
    """Steps of our rig on three others: planted balls within 5 mm of the floor, none below it, none sliding."""
    motion, other = walking(3.0), rig(**proportions)
    balls = list(other.config.feet)[1::2]
    standing_height = other.rest_positions[balls, 1]
    places = retarget(motion, other).pose().positions[:, balls]
    is_planted = planted(places, 30, standing_height=standing_height)
    over = places[..., 1] - standing_height
    assert is_planted.mean() > 0.3
    assert np.percentile(np.abs(over[is_planted]), 95) < 0.005  # the last frame before a foot lifts may be higher
    assert over.min() > -0.005
    assert skate(places, 30, standing_height=standing_height) < 0.3


def without_rest_pose(motion: Motion) -> Motion:
    """The same motion on a rig whose zero pose stands sideways with trunk and arms lying along X, as ACCAD's men do."""
    sideways = matrix_from_euler(np.array([0.0, 0.0, np.pi / 2]), "xzy").astype(np.float64)
    lying = matrix_from_euler(np.array([-1.2, 0.0, 0.3]), "zyx").astype(np.float64) @ sideways
    is_leg = [name == "hips" or name.endswith(("Leg", "Foot", "Toes")) for name in HUMANOID.names]
    built_in = np.stack([sideways if leg else lying for leg in is_leg])
    above = np.stack([built_in[p] if p >= 0 else np.eye(3) for p in HUMANOID.parents])
    offsets = (above.mT @ HUMANOID.offsets.astype(np.float64)[..., None])[..., 0]
    local = above.mT @ motion.matrices().astype(np.float64) @ built_in
    config = HUMANOID.config.model_copy(update={"offsets": tuple(map(tuple, offsets.tolist())), "tips": {}})
    return Motion(Skeleton(config), quaternion_from_matrix(local).astype(np.float32), motion.root, motion.fps)


def test_a_rig_whose_zero_pose_lies_on_its_side_stands_up():
    motion = walking(3.0)
    moved = retarget(without_rest_pose(motion), has_footing=False)
    for low, high in [("hips", "head"), ("rightUpperArm", "leftUpperArm"), ("leftUpperLeg", "leftLowerLeg")]:
        ways = []
        for one in (motion, moved):
            places = one.pose().positions
            ways.append(places[:, HUMANOID.index(high)] - places[:, HUMANOID.index(low)])
        angles = np.degrees(np.arccos(np.clip((unit(ways[0]) * unit(ways[1])).sum(-1), -1, 1)))
        assert float(angles.mean()) < 4, (low, high)


def test_a_wrist_at_the_tip_of_the_lower_arm_is_found():
    motion = standing(5)
    hands = {
        joint for joint, name in enumerate(HUMANOID.names) if "Hand" in name or joint in HUMANOID.config.parts["hands"]
    }
    kept = [joint for joint in range(HUMANOID.joints) if joint not in hands]
    tips = {f"{side}LowerArm": HUMANOID.config.offsets[HUMANOID.index(f"{side}Hand")] for side in ("left", "right")}
    config = SkeletonConfig(
        names=tuple(HUMANOID.names[j] for j in kept),
        parents=tuple(kept.index(HUMANOID.parents[j]) if j else -1 for j in kept),
        offsets=tuple(HUMANOID.config.offsets[j] for j in kept),
        tips=tips,
    )
    moved = retarget(Motion(Skeleton(config), motion.rotations[:, kept], motion.root, 30.0), has_footing=False)
    wrists = HUMANOID.indices(("leftHand", "rightHand"))
    np.testing.assert_allclose(moved.pose().positions[:, wrists], motion.pose().positions[:, wrists], atol=5e-3)


@pytest.mark.parametrize("has_tips", [True, False], ids=["with-tips", "without-tips"])
@pytest.mark.parametrize("heading_deg", [0, 90, -150])
def test_feet_without_toes_point_ahead_wherever_the_body_faces(has_tips, heading_deg):
    """Feet of rigs without toes, as Daz's: their tips tell where they point, or else the hips do."""
    motion = walking(3.0)
    heading = matrix_from_euler(np.array([np.radians(heading_deg), 0.0, 0.0]), "yxz").astype(np.float64)
    matrices = motion.matrices().astype(np.float64)
    matrices[:, 0] = heading @ matrices[:, 0]
    root = (heading @ motion.root.astype(np.float64)[..., None])[..., 0]
    kept = [joint for joint, name in enumerate(HUMANOID.names) if not name.endswith("Toes")]
    toes = {f"{side}Foot": HUMANOID.config.offsets[HUMANOID.index(f"{side}Toes")] for side in ("left", "right")}
    config = SkeletonConfig(
        names=tuple(HUMANOID.names[j] for j in kept),
        parents=tuple(kept.index(HUMANOID.parents[j]) if j else -1 for j in kept),
        offsets=tuple(HUMANOID.config.offsets[j] for j in kept),
        tips=toes if has_tips else {},
    )
    turned = Motion(
        Skeleton(config), quaternion_from_matrix(matrices[:, kept]).astype(np.float32), root.astype(np.float32), 30.0
    )
    moved = retarget(turned, has_footing=False).matrices(), retarget(motion, has_footing=False).matrices()
    feet = HUMANOID.indices(("leftFoot", "rightFoot"))
    between = (moved[0] @ moved[1].mT)[:, feet]
    angles = np.degrees(np.arccos(np.clip((np.trace(between, axis1=-2, axis2=-1) - 1) / 2, -1, 1)))
    assert float(np.median(angles)) < (1 if has_tips else 15)


def taller() -> Skeleton:
    """Our rig, a quarter larger, its arms hanging half-way down in the rest pose."""
    config = HUMANOID.config
    offsets = HUMANOID.offsets * 1.25
    turn = matrix_from_axis_angle(np.array([[0.0, 0.0, -0.7], [0.0, 0.0, 0.7]]))
    for joint, name in enumerate(config.names):
        for side, own in zip(("left", "right"), turn, strict=True):
            is_arm = name.startswith(side) and any(part in name for part in ("LowerArm", "Hand", "Thumb", "Index"))
            is_arm |= name.startswith(side) and any(part in name for part in ("Middle", "Ring", "Little"))
            if is_arm:
                offsets[joint] = own @ offsets[joint]
    return Skeleton(config.model_copy(update={"offsets": tuple(map(tuple, offsets.tolist()))}))


def test_a_rig_on_itself_changes_nothing() -> None:
    turns = matrix_from_axis_angle(0.3 * np.random.default_rng(0).standard_normal((5, 52, 3)))
    moved = LiveRetarget(HUMANOID)(turns)
    feet = [HUMANOID.index(name) for name in ("leftFoot", "leftToes", "rightFoot", "rightToes")]
    others = [joint for joint in range(52) if joint not in feet]
    np.testing.assert_allclose(moved.rotations[:, others], turns[:, others], atol=1e-5, rtol=0)
    assert angle_between(moved.rotations[:, feet], turns[:, feet]).max() < 1e-3
    np.testing.assert_allclose(moved.offset, np.zeros((5, 3), np.float32), atol=1e-5, rtol=0)


def test_bones_point_where_the_sources_do_and_the_rest_pose_stands_on_the_floor() -> None:
    source, live = taller(), LiveRetarget(taller())
    turns = matrix_from_axis_angle(0.3 * np.random.default_rng(1).standard_normal((6, 52, 3)))
    turns[0] = np.eye(3, dtype=np.float32)
    moved = live(turns)
    root = np.broadcast_to(source.offsets[:1], (6, 3))
    theirs = forward_kinematics(source, turns, root)
    ours = forward_kinematics(HUMANOID, moved.rotations, live.scale * root + moved.offset)
    bones = [("leftUpperArm", "leftLowerArm"), ("rightLowerArm", "rightHand"), ("leftUpperLeg", "leftLowerLeg")]
    for upper, lower in bones:
        a, b = HUMANOID.index(upper), HUMANOID.index(lower)
        one, other = (pose.positions[:, b] - pose.positions[:, a] for pose in (theirs, ours))
        assert (unit(one) * unit(other)).sum(-1).min() > 0.9999
    standing = ours.positions[0, [HUMANOID.index("leftFoot"), HUMANOID.index("rightFoot")], 1]
    np.testing.assert_allclose(standing, np.full(2, HUMANOID.rest_positions[HUMANOID.index("leftFoot"), 1]), atol=1e-5)
    assert live.scale == pytest.approx(0.8)


def test_a_clip_retargeted_at_once_agrees(swaying: tuple[np.ndarray, np.ndarray]) -> None:
    """Feet aside, whose rest `retarget` takes from the clip; frames one by one are those of the whole."""
    rotations, _ = swaying
    source = taller()
    turns = rotations[:20]
    clip = Motion(source, quaternion_from_matrix(turns), np.tile(source.offsets[0], (20, 1)), 30.0)
    whole = retarget(clip, has_footing=False).matrices()
    live = LiveRetarget(source)
    moved = np.concatenate([live(frame[None]).rotations for frame in turns])
    assert angle_between(moved, whole).max() < 2e-3


def test_a_rig_that_lies_down_is_refused() -> None:
    lying = HUMANOID.offsets[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    config = HUMANOID.config.model_copy(update={"offsets": tuple(map(tuple, lying.tolist()))})
    with pytest.raises(MotionError, match="stand upright"):
        LiveRetarget(Skeleton(config))
