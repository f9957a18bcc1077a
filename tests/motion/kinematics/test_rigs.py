import pytest
from tests.motion.kinematics.samples import chain, recorded

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID, Skeleton
from echoavatar.motion.kinematics.rigs import bone_map, finger_bones, known_bones

RIGS = {
    "motion_permissive/mesh2motion_cc0/greeting.bvh": (52, "thumb_01_l"),
    "motion_permissive/hifi_apache2/idle.bvh": (52, "LeftHandThumb1"),
    "motion_permissive/movebox_rocketbox_mit/rb_idle_neutral.bvh": (52, "Bip01_L_Finger0"),
    "motion_eval_only/zeroeggs_cc_by_nc_nd/067_Speech_2_x_1_0.bvh": (52, "LeftHandThumb1"),
}


@pytest.mark.parametrize("name", RIGS)
def test_known_rigs_are_known_whole(name):
    skeleton = read_bvh(recorded(name)).skeleton
    bones = bone_map(skeleton)
    count, thumb = RIGS[name]
    assert len(bones) == count
    assert skeleton.names[bones["leftThumbMetacarpal"]] == thumb


@pytest.mark.parametrize("name", RIGS)
def test_children_are_mapped_to_children(name):
    """Walking up from a mapped joint meets the joint of the bone's parent."""
    skeleton = read_bvh(recorded(name)).skeleton
    bones = bone_map(skeleton)
    for bone, joint in bones.items():
        parent = HUMANOID.parents[HUMANOID.index(bone)]
        above = set()
        while joint >= 0:
            joint = skeleton.parents[joint]
            above.add(joint)
        assert parent < 0 or bones[HUMANOID.names[parent]] in above


def test_a_rig_without_fingers_is_known():
    name = "motion_eval_only/bandai_namco_cc_by_nc/dataset-1/dataset-1_dance-short_normal_001.bvh"
    bones = bone_map(read_bvh(recorded(name)).skeleton)
    assert len(bones) == 21
    assert "chest" not in bones


def test_names_with_a_prefix_are_known():
    names = tuple("mixamorig:" + name for name in MIXAMO)
    config = chain(*[(0.0, 0.1, 0.0)] * len(names)).config.model_copy(update={"names": names})
    assert bone_map(Skeleton(config))["leftUpperArm"] == names.index("mixamorig:LeftArm")


MIXAMO = [
    *("Hips", "Spine", "Head"),
    *("LeftArm", "LeftForeArm", "LeftHand", "RightArm", "RightForeArm", "RightHand"),
    *("LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot"),
]


def test_daz_is_known_and_a_rig_without_hands_in_part():
    """FreeMoCap's forearms end in the wrist: nothing to retarget a hand from."""
    assert bone_map(read_bvh(recorded("motion_permissive/cmu_dance/60_01.bvh")).skeleton)["leftLowerArm"]
    skeleton = read_bvh(recorded("motion_permissive/reactidle_mit/000_genuine.bvh")).skeleton
    assert skeleton.names[known_bones(skeleton)["leftLowerArm"]] == "forearm.L"
    with pytest.raises(MotionError, match="no joint is leftHand"):
        bone_map(skeleton)


def test_an_unknown_rig_is_explained():
    with pytest.raises(MotionError, match="joint0, joint1.*not known"):
        bone_map(chain((0, 1, 0), (0, 1, 0)))


def test_a_vrm_map_is_believed():
    assert bone_map(HUMANOID)["leftHand"] == HUMANOID.index("leftHand")
    assert finger_bones("left")["Thumb"][0] == "leftThumbMetacarpal"
    assert all(bone in HUMANOID.names for bones in finger_bones("right").values() for bone in bones)


def test_the_lower_back_of_cmu_is_the_first_of_three_spine_bones():
    names = ["Hips", "LowerBack", "Spine", "Spine1", "Neck", "Head"]
    skeleton = chain(*[(0.0, 0.1, 0.0)] * len(names))
    named = Skeleton(skeleton.config.model_copy(update={"names": tuple(names)}))
    found = {bone: named.names[joint] for bone, joint in known_bones(named).items()}
    assert [found[bone] for bone in ("spine", "chest", "upperChest")] == ["LowerBack", "Spine", "Spine1"]
