"""What names of joints say, one by one."""

import time

import pytest

from echoavatar.motion.kinematics.joint_words import read_name, read_names

WORDS = {
    "mixamorig:LeftUpLeg": ("left", "thigh"),
    "mixamorigLeftUpLeg": ("left", "thigh"),
    "mixamorighips": ("", "hips"),
    "J_Bip_L_UpperLeg": ("left", "thigh"),
    "thigh.L.001": ("left", "thigh"),
    "lfemur": ("left", "thigh"),
    "RUArm": ("right", "upperarm"),
    "Arm_Lower_R": ("right", "elbow"),
    "右足首": ("right", "ankle"),
    "左人指１": ("left", "index"),
    "LeftHandThumb1": ("left", "thumb"),
    "left_foot_index": ("left", "toe"),
    "SpineShoulder": ("", "trunk"),
    "Footsteps": ("", ""),
    "Handle": ("", ""),
}


@pytest.mark.parametrize("name", WORDS)
def test_a_name_says_a_side_and_a_part(name):
    said = read_name(name)
    assert (said.side, said.part) == WORDS[name]


@pytest.mark.parametrize(
    "name", ["upperarm_twist_01_l", "左足ＩＫ", "hair_01", "HeadTop_End", "skirt.L", "ik_hand_l", "Earring_L"]
)
def test_helpers_are_told(name):
    assert read_name(name).is_helper


def test_fingers_have_numbers_and_palms():
    assert [read_name(name).number for name in ("Bip01 L Finger01", "LeftFinger2Tip", "FingerBase.001")] == [1, 2, -1]
    assert read_name("index_metacarpal_l").is_metacarpal


def test_words_beside_many_parts_label_the_rig():
    names = ["Bip01_Pelvis", "Bip01_Spine", "Bip01_Neck", "Bip01_Head", "Bip01_L_Thigh", "Bip01_L_Calf", "hero_Hand"]
    assert [said.strangers for said in read_names(names)] == [()] * 6 + [("hero",)]


@pytest.mark.parametrize("names", [["x" * 4096, "l" * 4096], ["left" * 60, "ハ゛" * 200], ["", ":"], ["\ud800", "١٢٣"]])
def test_names_without_end_or_sense_are_read_at_once(names):
    assert all(not said.part for said in read_names(names))


def test_long_names_of_separators_are_read_at_once():
    began = time.process_time()
    assert read_names([f"{number}{'_' * 20_000}" for number in range(20)])
    assert time.process_time() - began < 2
