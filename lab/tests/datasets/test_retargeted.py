from dataclasses import replace

import numpy as np
import pytest
from lab.tests.datasets.samples import SHARED, gesture, motorica_names, renamed

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import angle_between, quaternion_from_axis_angle, quaternion_multiply
from echoavatar_lab.data.corpus import can_mirror
from echoavatar_lab.data.statistics import arm_length
from echoavatar_lab.datasets.retargeted import annotate_rig, fidelity, keep_hand_contact


def test_our_own_rig_gets_the_parts_it_has():
    bare = gesture(0.2)
    config = bare.skeleton.config.model_copy(update={"parts": {}, "mirror": (), "feet": ()})
    found = annotate_rig(Motion(Skeleton(config), bare.rotations, bare.root, bare.fps)).skeleton.config
    for part, joints in HUMANOID.config.parts.items():
        assert sorted(found.parts[part]) == sorted(joints)
    assert found.mirror == HUMANOID.config.mirror
    assert found.feet == HUMANOID.config.feet


def test_a_foreign_rig_is_known_by_its_names():
    rig = annotate_rig(renamed(gesture(0.2), motorica_names())).skeleton
    names = {part: {rig.names[joint] for joint in joints} for part, joints in rig.config.parts.items()}
    assert {"Hips", "LeftUpLeg", "RightToeBase"} <= names["lower"]
    assert {"Spine", "Head", "LeftHand"} <= names["upper"]
    assert {"LeftHandPinky3", "RightHandThumb1"} <= names["hands"]
    assert sum(map(len, names.values())) == rig.joints
    assert rig.names[rig.config.mirror[rig.index("LeftHandPinky3")]] == "RightHandPinky3"
    assert can_mirror(rig)


def test_marks_of_the_side_at_the_end_or_in_the_middle_are_understood():
    rig = renamed(gesture(0.2), motorica_names()).skeleton
    for old, new in ((("Left", "Bip_L"), ("Right", "Bip_R")), (("Left", "l_"), ("Right", "r_"))):
        names = tuple(name.replace(*old).replace(*new) for name in rig.names)
        vrm = {bone: rig.index(name) for bone, name in motorica_names().items()}
        config = rig.config.model_copy(update={"names": names, "vrm": vrm})
        motion = Motion(
            Skeleton(config),
            np.tile([1, 0, 0, 0], (2, rig.joints, 1)).astype(np.float32),
            np.zeros((2, 3), np.float32),
            30.0,
        )
        found = annotate_rig(motion).skeleton.config
        assert found.mirror == annotate_rig(renamed(gesture(0.2), motorica_names())).skeleton.config.mirror


def test_a_rig_of_unknown_names_is_refused():
    rig = gesture(0.2).skeleton
    config = rig.config.model_copy(
        update={"names": tuple(f"j{k}" for k in range(rig.joints)), "vrm": {}, "offsets": ((0.0,) * 3,) * rig.joints}
    )
    motion = gesture(0.2)
    with pytest.raises(MotionError, match="is not known"):
        annotate_rig(Motion(Skeleton(config), motion.rotations, motion.root, motion.fps))


HANDS = HUMANOID.indices(("leftHand", "rightHand"))


def folding(seconds: float = 4.0) -> Motion:
    """Hanging upper arms rotate inwards and back, so that bent forearms meet in front of the belly and part."""
    motion = gesture(seconds)
    rotations = motion.rotations.copy()
    inward = 0.9 * np.sin(np.pi * np.arange(motion.frames) / motion.frames) ** 2
    none = np.zeros_like(inward)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        down = quaternion_from_axis_angle(np.stack([none, none, none - sign * 1.35], 1))
        turn = quaternion_from_axis_angle(np.stack([inward, none, none], 1))
        bend = quaternion_from_axis_angle(np.stack([none, none - sign * 1.5, none], 1))
        rotations[:, HUMANOID.index(f"{side}UpperArm")] = quaternion_multiply(down, turn)
        rotations[:, HUMANOID.index(f"{side}LowerArm")] = bend
    return replace(motion, rotations=rotations)


def narrow(motion: Motion, by: float = 0.04) -> Motion:
    """The same rotations on a body whose shoulders are narrower by `by` metres on each side."""
    offsets = list(motion.skeleton.config.offsets)
    for side, sign in (("left", 1), ("right", -1)):
        x, y, z = offsets[HUMANOID.index(f"{side}UpperArm")]
        offsets[HUMANOID.index(f"{side}UpperArm")] = (x - sign * by, y, z)
    return replace(motion, skeleton=Skeleton(motion.skeleton.config.model_copy(update={"offsets": tuple(offsets)})))


def apart(motion: Motion) -> np.ndarray:
    places = motion.pose().positions[:, HANDS]
    return np.linalg.norm(places[:, 0] - places[:, 1], axis=-1)


def test_hands_that_meet_come_as_near_as_they_were():
    source = narrow(folding())
    before = retarget(source)
    near = apart(source) < 0.35 * arm_length(source.skeleton)
    assert bool(near.any()), "the gesture must bring the hands together"
    assert float((apart(before) - apart(source))[near].min()) > 0.05
    after = keep_hand_contact(before, source)
    np.testing.assert_allclose(apart(after)[near], apart(source)[near], atol=5e-3)


def test_hands_keep_their_orientation_and_the_rest_of_the_body_its_pose():
    source = narrow(folding())
    before = retarget(source)
    after = keep_hand_contact(before, source)
    hands = angle_between(before.pose().rotations[:, HANDS], after.pose().rotations[:, HANDS])
    assert float(np.degrees(hands).max()) < 0.1
    arms = HUMANOID.indices([f"{s}{b}" for s in ("left", "right") for b in ("UpperArm", "LowerArm", "Hand")])
    others = [j for j in range(HUMANOID.joints) if j not in arms]
    np.testing.assert_allclose(before.rotations[:, others], after.rotations[:, others], atol=1e-6)


def test_nothing_jumps_on_the_way():
    """The hands are corrected by up to 4 cm; a jump would be an acceleration of 4 cm per frame squared."""
    source = narrow(folding())
    after = keep_hand_contact(retarget(source), source)
    assert float(np.linalg.norm(np.diff(after.pose().positions[:, HANDS], n=2, axis=0), axis=-1).max()) < 1e-3


def test_hands_that_stay_apart_are_left_alone():
    hanging = gesture(1.0)
    rotations = hanging.rotations.copy()
    rotations[:] = [1, 0, 0, 0]
    still = replace(hanging, rotations=rotations)  # a T-pose
    assert keep_hand_contact(still, narrow(still)) is still


def test_arm_length_is_upper_arm_and_forearm():
    assert arm_length(HUMANOID) == pytest.approx(0.265 + 0.245)


def test_a_bent_arm_shows_in_angle_and_distance():
    """Both forearms differ by 90 degrees: two of four bones, so 45 in the mean."""
    motion = gesture()
    rotations = motion.rotations.copy()
    rotations[:] = [1, 0, 0, 0]
    straight = replace(motion, rotations=rotations.copy())
    for side, sign in (("left", -1), ("right", 1)):
        rotations[:, HUMANOID.index(f"{side}LowerArm")] = [np.sqrt(0.5), 0, sign * np.sqrt(0.5), 0]
    numbers = fidelity(straight, replace(motion, rotations=rotations))
    assert numbers["arm_angle_deg"] == pytest.approx(45, abs=0.1)
    assert numbers["hands_apart_error"] > 0.5


def test_feet_that_leave_the_floor_show_in_the_contacts():
    motion = gesture()
    root = motion.root.copy()
    root[45:, 1] += 0.5
    assert fidelity(motion, replace(motion, root=root))["contacts_agree"] == pytest.approx(0.5, abs=0.05)


@pytest.mark.skipif(
    not SHARED.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
@pytest.mark.parametrize(
    ("path", "contacts"),
    [
        ("zeroeggs_cc_by_nc_nd/067_Speech_2_x_1_0.bvh", 0.95),
        ("bandai_namco_cc_by_nc/dataset-1/dataset-1_bow_normal_001.bvh", 0.95),
        ("bandai_namco_cc_by_nc/dataset-1/dataset-1_dance-short_normal_001.bvh", 0.8),  # settling plants more
    ],
)
def test_real_recordings_keep_contacts_arms_and_hands(path, contacts):
    """The bow folds its hands (13 cm between the wrists): narrower shoulders than ours need arm IK."""
    source = resample(read_bvh(SHARED / path), 30.0)
    numbers = fidelity(source, keep_hand_contact(retarget(source), source))
    assert numbers["contacts_agree"] > contacts
    assert numbers["skate_cm_s"] < 0.6 * numbers["skate_source_cm_s"] + 0.1
    assert numbers["hands_together_error"] < 0.02
    assert numbers["arm_angle_deg"] < 6.5


@pytest.mark.parametrize(("bone", "part"), [("spine", "trunk"), ("leftUpperLeg", "leg"), ("upperChest", "shoulders")])
def test_a_turned_part_shows_in_its_own_angle(bone, part):
    motion = gesture()
    straight = np.zeros_like(motion.rotations)
    straight[..., 0] = 1
    turned = straight.copy()
    turned[:, HUMANOID.index(bone)] = [np.cos(0.5), 0, 0, np.sin(0.5)]
    numbers = fidelity(replace(motion, rotations=straight), replace(motion, rotations=turned))
    assert numbers[f"{part}_angle_deg"] > 20
    assert numbers["arm_angle_deg" if part == "leg" else "leg_angle_deg"] < 30


@pytest.mark.parametrize("name", ["Male1_A2_Sway", "Male2_A4_LookAround", "Female1_A04_Look"])
def test_captured_rigs_whose_zero_pose_is_none_keep_trunk_and_shoulders(name):
    """ACCAD's men rest with their bones along X: the trunk came out 80 degrees off and the shoulders reversed."""
    path = SHARED.parent / f"motion_permissive/accad_cc_by/{name}.bvh"
    if not path.exists():
        pytest.skip("needs ../shared/data, which only a checkout with the authors' recordings has")
    source = read_bvh(path)
    numbers = fidelity(source, retarget(source))
    assert numbers["trunk_angle_deg"] < 5
    assert numbers["shoulders_angle_deg"] < 4
