import numpy as np
import pytest
from lab.tests.datasets.samples import gesture, motorica_names, renamed

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar_lab.data.corpus import can_mirror
from echoavatar_lab.datasets.native_rig import annotate_rig


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
    config = rig.config.model_copy(update={"names": tuple(f"j{k}" for k in range(rig.joints)), "vrm": {}})
    motion = gesture(0.2)
    with pytest.raises(MotionError, match="is not known"):
        annotate_rig(Motion(Skeleton(config), motion.rotations, motion.root, motion.fps))
