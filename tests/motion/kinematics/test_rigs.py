"""Joints of any rig are recognised: by names, by the shape of the body, by a map of the user's."""

import numpy as np
import pytest
from tests.motion.kinematics.naming import FRAMED, SCHEMES, body, every_body
from tests.motion.kinematics.samples import chain, recorded

from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID, Skeleton
from echoavatar.motion.kinematics.joint_words import read_names
from echoavatar.motion.kinematics.rigs import (
    REQUIRED,
    Tree,
    UnknownRigError,
    bone_map,
    find_bones,
    finger_bones,
    known_bones,
)

EXTRA = {"leftEye", "rightEye", "jaw"}


def names_of(skeleton: Skeleton) -> dict[str, str]:
    return {bone: skeleton.names[joint] for bone, joint in known_bones(skeleton).items() if bone not in EXTRA}


def test_there_are_many_schemes():
    assert len(SCHEMES) + len(FRAMED) >= 50


@pytest.mark.parametrize("has_noise", [False, True], ids=["plain", "noise"])
@pytest.mark.parametrize("name", every_body())
def test_every_bone_of_a_scheme_is_found_and_nothing_else_is_taken_for_one(name, has_noise):
    made = body(*every_body()[name], has_noise=has_noise)
    assert names_of(made.skeleton) == made.bones


@pytest.mark.parametrize("name", [name for name, (scheme, _) in every_body().items() if scheme.has_all_names])
def test_names_are_enough_where_no_place_says_anything(name):
    made = body(*every_body()[name], has_noise=True)
    config = made.skeleton.config
    nowhere = Skeleton(config.model_copy(update={"offsets": ((0.0, 0.0, 0.0),) * len(config.names)}))
    assert names_of(nowhere) == made.bones


@pytest.mark.parametrize("frame", ["{}_jnt", "hero_{}", "rig:{}", "Armature|{}", "{}.001", "{} (1)", "upper", "lower"])
def test_what_stands_around_the_names_of_a_scheme_does_not_matter(frame):
    """Nor does their case; each with noise, and no place says anything."""
    for name, (scheme, own) in every_body().items():
        made = body(scheme, own, has_noise=True)
        put = [getattr(joint, frame)() if "{" not in frame else frame.format(joint) for joint in made.skeleton.names]
        if scheme.has_all_names:
            nowhere = renamed(made.skeleton, put, np.zeros((made.skeleton.joints, 3)))
            found = {bone: joint for bone, joint in known_bones(nowhere).items() if bone not in EXTRA}
            assert found == {bone: made.skeleton.index(joint) for bone, joint in made.bones.items()}, name


UNREAL = SCHEMES["Unreal 4"]
AMBIGUOUS = {
    "leg is the thigh": {"leg": "UpperLeg=leg_{s}/LowerLeg=shin_{s}/Foot=foot_{s}/Toes=toe_{s}"},
    "leg is the shin": {"leg": "UpperLeg=thigh_{s}/LowerLeg=leg_{s}/Foot=foot_{s}/Toes=toe_{s}"},
    "leg is both": {"leg": "UpperLeg=leg_{s}/LowerLeg=leg_{s}.001/Foot=foot_{s}"},
    "a hip above the thigh": {"leg": "=hip_{s}/UpperLeg=thigh_{s}/LowerLeg=knee_{s}/Foot=ankle_{s}/Toes=toe_{s}"},
    "hip is the thigh": {"leg": "UpperLeg=hip_{s}/LowerLeg=knee_{s}/Foot=ankle_{s}/Toes=foot_{s}"},
    "hip is the root": {"trunk": UNREAL.trunk.replace("pelvis", "hip"), "leg": UNREAL.leg},
    "foot below ankle": {"leg": "UpperLeg=hip_{s}/LowerLeg=leg_{s}/Foot=ankle_{s}/=foot_{s}/Toes=toe_{s}"},
    "shoulder is the clavicle": {"arm": "Shoulder=shoulder_{s}/UpperArm=arm_{s}/LowerArm=forearm_{s}/Hand=hand_{s}"},
    "shoulder is the upper arm": {"arm": "Shoulder=collar_{s}/UpperArm=shoulder_{s}/LowerArm=elbow_{s}/Hand=hand_{s}"},
    "shoulder without clavicle": {"arm": "UpperArm=shoulder_{s}/LowerArm=elbow_{s}/Hand=wrist_{s}"},
    "arm is both": {"arm": "Shoulder=clavicle_{s}/UpperArm=arm_{s}/LowerArm=arm_{s}.001/Hand=hand_{s}"},
    "hand below wrist": {"arm": "UpperArm=arm_{s}/LowerArm=forearm_{s}/Hand=wrist_{s}/=hand_{s}"},
    "upper and lower behind": {
        "arm": "Shoulder=clav_{s}/UpperArm=arm_upper_{s}/LowerArm=arm_lower_{s}/Hand=hand_{s}".replace(
            "clav_", "collar_"
        ),
        "leg": "UpperLeg=leg_upper_{s}/LowerLeg=leg_lower_{s}/Foot=foot_{s}",
    },
    "no neck": {"trunk": "hips=hips/spine=torso/head=head"},
}


@pytest.mark.parametrize("name", AMBIGUOUS)
def test_the_order_along_a_limb_settles_words_that_mean_several_bones(name):
    made = body(UNREAL._replace(fingers="", **AMBIGUOUS[name]), has_noise=True)
    assert names_of(made.skeleton) == made.bones


def renamed(skeleton: Skeleton, names: list[str], places: np.ndarray | None = None) -> Skeleton:
    config = skeleton.config
    rest = skeleton.rest_positions.double().numpy() if places is None else places
    above = [rest[parent] if parent >= 0 else np.zeros(3) for parent in config.parents]
    offsets = tuple(map(tuple, (rest - np.array(above)).tolist()))
    return Skeleton(config.model_copy(update={"names": tuple(names), "offsets": offsets, "vrm": {}}))


NAMELESS = {
    "numbers": "bone_{:02}",
    "Blender's own": "Bone.{:03}",
    "Chinese": "骨骼{}",
    "Russian": "Кость_{}",
    "a word of ours": "arm_{}",
}
ASKEW = {  # columns: where our x, y and z go
    "as ours": np.eye(3),
    "facing -Z": np.diag([-1.0, 1.0, -1.0]),
    "Z up": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T,
    "facing +X": np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]).T,
    "in centimetres": 100 * np.eye(3),
}


@pytest.mark.parametrize("turn", ASKEW)
@pytest.mark.parametrize("word", NAMELESS)
def test_a_body_without_names_is_read_by_its_shape(word, turn):
    names = [NAMELESS[word].format(k) for k in range(HUMANOID.joints)]
    turned = renamed(HUMANOID, names, HUMANOID.rest_positions.double().numpy() @ ASKEW[turn].T)
    assert known_bones(turned) == HUMANOID.config.vrm


STRANGE_PLACES = ("3ds Max", "MikuMikuDance")  # legs on the spine; joints in one place


@pytest.mark.parametrize("has_noise", [False, True], ids=["plain", "noise"])
@pytest.mark.parametrize("name", [name for name in every_body() if name not in STRANGE_PLACES])
def test_every_scheme_is_read_by_its_shape(name, has_noise):
    """The bones that motion needs: hair, cloth and twist joints without names are not taken for them."""
    made = body(*every_body()[name], has_noise=has_noise)
    nameless = renamed(made.skeleton, [f"bone_{k}" for k in range(made.skeleton.joints)])
    found = {bone: made.skeleton.names[joint] for bone, joint in known_bones(nameless).items()}
    assert {bone: found.get(bone) for bone in REQUIRED} == {bone: made.bones[bone] for bone in REQUIRED}


@pytest.mark.parametrize(
    "name", ["mesh2motion_cc0/greeting.bvh", "hifi_apache2/idle.bvh", "accad_cc_by/Female1_A01_Stand.bvh"]
)
def test_recorded_rigs_are_the_same_by_names_and_by_shape(name):
    skeleton = read_bvh(recorded(f"motion_permissive/{name}.bvh")).skeleton
    named = {bone: joint for bone, joint in known_bones(skeleton).items() if bone not in EXTRA}
    assert known_bones(renamed(skeleton, [f"bone_{k}" for k in range(skeleton.joints)])) == named


def test_sides_in_names_that_say_nothing_else_are_believed():
    names = [f"bone_{name[0].upper()}_{k}" if name[:4] in ("left", "righ") else f"bone_{k}"
             for k, name in enumerate(HUMANOID.names)]  # fmt: skip
    backwards = HUMANOID.rest_positions.double().numpy() * [1, 1, -1]  # toes behind: by shape left were right
    assert known_bones(renamed(HUMANOID, names, backwards)) == HUMANOID.config.vrm


def test_shape_does_not_overrule_names():
    """Forearms that end in the wrist: their tips are the hands, and a shoulder is no upper arm."""
    scheme = UNREAL._replace(arm="Shoulder=clavicle_{s}/UpperArm=upperarm_{s}/LowerArm=lowerarm_{s}", fingers="")
    made = body(scheme)
    assert names_of(made.skeleton) == made.bones
    with pytest.raises(UnknownRigError, match="no joint is leftHand, rightHand"):
        bone_map(made.skeleton)


def test_names_are_believed_where_the_feet_point_back_and_that_is_said(caplog):
    names = list(HUMANOID.names)
    backwards = HUMANOID.rest_positions.double().numpy() * [1, 1, -1]
    assert known_bones(renamed(HUMANOID, names, backwards)) == HUMANOID.config.vrm
    assert "names are believed" in caplog.text


def test_a_body_that_faces_away_is_no_contradiction(caplog):
    away = renamed(HUMANOID, list(HUMANOID.names), HUMANOID.rest_positions.double().numpy() * [-1, 1, -1])
    assert known_bones(away) == HUMANOID.config.vrm
    assert not caplog.text


_LEGS = [f"{side}{bone}" for side in ("left", "right") for bone in ("UpperLeg", "LowerLeg", "Foot")]
SECOND = {  # the joints of another thing in the file, and their parents
    "a chair with hips": (["chair", "Hips", "LeftUpLeg", "LeftLeg", "RightUpLeg", "Head"], [-1, 0, 1, 2, 1, 1]),
    "controls": ([f"CTRL_{name}" for name in HUMANOID.names], list(HUMANOID.parents)),
    "a body of legs alone": (["hips", *_LEGS], [-1, 0, 1, 2, 0, 4, 5]),
}


@pytest.mark.parametrize("is_under_one", [False, True], ids=["two trees", "one tree"])
@pytest.mark.parametrize("name", SECOND)
def test_the_most_complete_of_two_bodies_is_taken(name, is_under_one):
    names, parents = ["scene"] * is_under_one + SECOND[name][0], [-1] * is_under_one
    parents += [parent + is_under_one for parent in SECOND[name][1]]
    made = body(*every_body()["Mixamo"], has_noise=True)
    count = len(names)
    parents += [parent + count if parent >= 0 else is_under_one - 1 for parent in made.skeleton.parents]
    places = np.concatenate([np.zeros((count, 3)), made.skeleton.rest_positions.double().numpy()])
    tree = Tree([*names, *made.skeleton.names], parents, places)
    found = {bone: tree.names[joint] for bone, joint in find_bones(tree).items() if bone not in EXTRA}
    assert found == made.bones
    assert all(joint >= count for joint in find_bones(tree).values())


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


@pytest.mark.parametrize("names", [["x" * 4096, "l" * 4096], ["left" * 60, "ハ゛" * 200], ["", ":"], ["\ud800", "١٢٣"]])
def test_names_without_end_or_sense_are_read_at_once(names):
    assert all(not said.part for said in read_names(names))


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
