"""Names of many programs are read, with all that stands beside a body."""

import numpy as np
import pytest
from tests.motion.kinematics.naming import EXTRA, FRAMED, SCHEMES, body, every_body, names_of, renamed

from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.joint_tree import Tree
from echoavatar.motion.kinematics.rigs import find_bones, known_bones

UNREAL = SCHEMES["Unreal 4"]


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


PIVOTS = {  # what stands above each joint
    "Assimp": ("{}_$AssimpFbx$_Translation", "{}_$AssimpFbx$_PreRotation", "{}_$AssimpFbx$_Rotation"),
    "groups of Maya": ("{}_grp", "{}_sdk"),
    "offsets": ("{}_offset",),
    "a word in front": ("zero{}",),
}


@pytest.mark.parametrize("is_above", [False, True], ids=["in its place", "in its parent's place"])
@pytest.mark.parametrize("pivots", PIVOTS)
def test_the_joint_is_the_bone_and_not_the_pivots_above_it(pivots, is_above):
    """A clip that turns the pivots turns the joint below them, and not the other way round. In any language."""
    for name, (scheme, frame) in every_body().items():
        made = body(scheme, frame)
        names, parents, offsets, last = list[str](), list[int](), list[tuple[float, float, float]](), {-1: -1}
        for joint, written in enumerate(made.skeleton.names):
            chain = [*(pivot.format(written) for pivot in PIVOTS[pivots]), written]
            parents += [last[made.skeleton.parents[joint]], *range(len(names), len(names) + len(chain) - 1)]
            steps = [made.skeleton.config.offsets[joint], *[(0.0, 0.0, 0.0)] * (len(chain) - 1)]
            offsets += steps[::-1] if is_above else steps
            names += chain
            last[joint] = len(names) - 1
        config = SkeletonConfig(names=tuple(names), parents=tuple(parents), offsets=tuple(offsets))
        assert names_of(Skeleton(config)) == made.bones, name


AMBIGUOUS = {
    "arms counted": {"arm": "UpperArm=arm_{s}_1/=arm_{s}_2/LowerArm=arm_{s}_3/Hand=hand_{s}"},
    "arms counted from the collar": {"arm": "Shoulder=arm_{s}_1/UpperArm=arm_{s}_2/LowerArm=arm_{s}_3/Hand=hand_{s}"},
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
    "biomechanics": {"leg": "UpperLeg=femur_{s}/LowerLeg=shank_{s}/Foot=talus_{s}/=calcn_{s}/Toes=toes_{s}"},
    "legs counted": {"leg": "UpperLeg=leg_1_{s}/LowerLeg=leg_2_{s}/Foot=leg_3_{s}"},
    "legs counted to the toes": {"leg": "UpperLeg=leg_1_{s}/LowerLeg=leg_2_{s}/Foot=leg_3_{s}/Toes=leg_4_{s}"},
    "legs counted to the foot": {"leg": "UpperLeg=leg_1_{s}/LowerLeg=leg_2_{s}/Foot=foot_1_{s}/Toes=foot_2_{s}"},
    "the limb in front": {
        "arm": "Shoulder={s}Arm_Collarbone/UpperArm={s}Arm_UpperArm/LowerArm={s}Arm_ForeArm/Hand={s}Arm_Hand",
        "leg": "UpperLeg={s}Leg_Thigh/LowerLeg={s}Leg_Calf/Foot={s}Leg_Foot/Toes={s}Leg_Toe1",
    },
    "anatomy in Japanese": {
        "arm": "Shoulder={s}鎖骨/UpperArm={s}上腕/LowerArm={s}前腕/Hand={s}手",
        "leg": "UpperLeg={s}大腿/LowerLeg={s}下腿/Foot={s}足/Toes={s}つま先",
        "sides": ("左", "右"),
    },
    "no neck": {"trunk": "hips=hips/spine=torso/head=head"},
}


@pytest.mark.parametrize("name", AMBIGUOUS)
def test_the_order_along_a_limb_settles_words_that_mean_several_bones(name):
    made = body(UNREAL._replace(fingers="", **AMBIGUOUS[name]), has_noise=True)
    assert names_of(made.skeleton) == made.bones


def test_the_label_of_a_body_is_known_beside_many_other_things():
    """As in the constants of OpenXR, where BODY and JOINT say nothing."""
    made = body(UNREAL._replace(fingers=""), "XR_BODY_JOINT_{}_HTC")
    names = [*made.skeleton.names, *(f"prop_{k}" for k in range(made.skeleton.joints))]
    parents = [*made.skeleton.parents, *range(made.skeleton.joints)]
    places = np.concatenate([made.skeleton.rest_positions, made.skeleton.rest_positions + [0, 0.004, -0.01]])
    found = find_bones(Tree(names, parents, places))
    assert {bone: names[joint] for bone, joint in found.items() if bone not in EXTRA} == made.bones


CONTROLS = {
    "UpperArm": "c_arm_fk", "LowerArm": "c_forearm_fk", "Hand": "c_hand_fk",
    "UpperLeg": "c_thigh_fk", "LowerLeg": "c_leg_fk", "Foot": "c_foot_fk", "Toes": "c_toes_fk",
}  # fmt: skip


def test_controls_beside_the_bones_are_no_bones():
    """Auto-Rig Pro exports its controls in the places of the bones, a leaf on each finger, and a joint in the palm."""
    made = body(*every_body()["Auto-Rig Pro"])
    rest, bones = made.skeleton.rest_positions, {joint: bone for bone, joint in made.bones.items()}
    listed, last = dict[str, tuple[str, np.ndarray]](), ""
    for joint, (name, parent) in enumerate(zip(made.skeleton.names, made.skeleton.parents, strict=True)):
        above, bone = made.skeleton.names[parent] if parent >= 0 else "", bones.get(name, "")
        if control := CONTROLS.get(bone.removeprefix("left").removeprefix("right")):
            over = "root.x" if bone.endswith(("UpperArm", "UpperLeg")) else f"{last}.{name[-1]}"
            listed[f"{control}.{name[-1]}"] = over, rest[joint]
            last = control
        elif name.startswith("c_") and name[-3] == "1":
            if "thumb" not in name:
                listed[above := f"{name[:-2]}_base{name[-2:]}"] = made.skeleton.names[parent], rest[joint] / 2
            listed[name] = above, rest[joint]
            listed[name[2:]] = name, rest[joint]
        listed.setdefault(name, (above, rest[joint]))
    names = list(listed)
    parents = [names.index(above) if above else -1 for above, _ in listed.values()]
    tree = Tree(names, parents, np.array([place for _, place in listed.values()]))
    found = {bone: names[joint] for bone, joint in find_bones(tree).items() if bone not in EXTRA}
    assert len(names) > made.skeleton.joints + 30
    assert found == made.bones


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
    places = np.concatenate([np.zeros((count, 3)), made.skeleton.rest_positions.astype(np.float64)])
    tree = Tree([*names, *made.skeleton.names], parents, places)
    found = {bone: tree.names[joint] for bone, joint in find_bones(tree).items() if bone not in EXTRA}
    assert found == made.bones
    assert all(joint >= count for joint in find_bones(tree).values())
