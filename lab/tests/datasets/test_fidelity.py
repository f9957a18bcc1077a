from dataclasses import replace

import numpy as np
import pytest
from lab.tests.datasets.samples import SHARED, gesture

from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar_lab.datasets.fidelity import fidelity
from echoavatar_lab.datasets.hand_contact import keep_hand_contact


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
