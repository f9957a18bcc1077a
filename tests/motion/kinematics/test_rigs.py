"""Joints of any rig are recognised: by names or by the shape of the body, and errors say what is missing."""

import numpy as np
import pytest
from tests.motion.kinematics.naming import EXTRA, SCHEMES, body, names_of, renamed
from tests.motion.kinematics.samples import chain, recorded

from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.named_bones import finger_bones
from echoavatar.motion.kinematics.rigs import UnknownRigError, bone_map, known_bones

UNREAL = SCHEMES["Unreal 4"]


def test_shape_does_not_overrule_names():
    """Forearms that end in the wrist: their tips are the hands, and a shoulder is no upper arm."""
    scheme = UNREAL._replace(arm="Shoulder=clavicle_{s}/UpperArm=upperarm_{s}/LowerArm=lowerarm_{s}", fingers="")
    made = body(scheme)
    assert names_of(made.skeleton) == made.bones
    with pytest.raises(UnknownRigError, match="no joint is leftHand, rightHand"):
        bone_map(made.skeleton)


@pytest.mark.parametrize("sides", [(1, 1, -1), (-1, 1, -1)], ids=["its feet point back", "it faces away"])
def test_names_are_believed(sides):
    placed = renamed(HUMANOID, list(HUMANOID.names), HUMANOID.rest_positions.astype(np.float64) * sides)
    assert known_bones(placed) == HUMANOID.config.vrm


def test_what_is_no_body_is_explained():
    with pytest.raises(UnknownRigError, match="no joint is hips.*found: nothing; not placed: joint0, joint1.*--map"):
        bone_map(chain((0, 1, 0), (0, 1, 0)))
    made = body(UNREAL._replace(leg="UpperLeg=thigh_{s}", fingers=""), has_noise=True)
    with pytest.raises(UnknownRigError) as caught:
        bone_map(made.skeleton)
    assert "no joint is leftLowerLeg, leftFoot, rightLowerLeg, rightFoot;" in str(caught.value)
    assert "found: hips (pelvis), head (head), leftUpperArm (upperarm_l) and 7 more" in str(caught.value)
    assert "not placed: root, " in str(caught.value)
    assert caught.value.found["rightHand"] == "hand_r"


def test_a_vrm_map_is_believed():
    assert bone_map(HUMANOID)["leftHand"] == HUMANOID.index("leftHand")
    assert finger_bones("left")["Thumb"][0] == "leftThumbMetacarpal"
    assert all(bone in HUMANOID.names for bones in finger_bones("right").values() for bone in bones)


RIGS = {
    "motion_permissive/mesh2motion_cc0/greeting.bvh": (52, "thumb_01_l"),
    "motion_permissive/hifi_apache2/idle.bvh": (52, "LeftHandThumb1"),
    "motion_permissive/movebox_rocketbox_mit/rb_idle_neutral.bvh": (52, "Bip01_L_Finger0"),
    "motion_eval_only/zeroeggs_cc_by_nc_nd/067_Speech_2_x_1_0.bvh": (52, "LeftHandThumb1"),
    "motion_eval_only/bandai_namco_cc_by_nc/dataset-1/dataset-1_dance-short_normal_001.bvh": (21, ""),
    "motion_permissive/cmu_dance/60_01.bvh": (39, "lThumb1"),
}


@pytest.mark.parametrize("name", RIGS)
def test_recorded_rigs_are_known_whole_and_children_hang_from_parents(name):
    skeleton = read_bvh(recorded(name)).skeleton
    bones = {bone: joint for bone, joint in bone_map(skeleton).items() if bone not in EXTRA}
    count, thumb = RIGS[name]
    assert len(bones) == count
    assert not thumb or skeleton.names[bones["leftThumbMetacarpal"]] == thumb
    for bone, joint in bones.items():
        above, parent = set(), HUMANOID.parents[HUMANOID.index(bone)]
        while joint >= 0:
            joint = skeleton.parents[joint]
            above.add(joint)
        while parent >= 0 and HUMANOID.names[parent] not in bones:
            parent = HUMANOID.parents[parent]
        assert parent < 0 or bones[HUMANOID.names[parent]] in above
