"""A body whose names say nothing is read by its shape."""

import numpy as np
import pytest
from tests.motion.kinematics.naming import EXTRA, body, every_body, renamed
from tests.motion.kinematics.samples import recorded

from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.joint_tree import REQUIRED, Tree
from echoavatar.motion.kinematics.rigs import known_bones
from echoavatar.motion.kinematics.shaped_bones import shaped_bones

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
    turned = renamed(HUMANOID, names, HUMANOID.rest_positions.astype(np.float64) @ ASKEW[turn].T)
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
    backwards = HUMANOID.rest_positions.astype(np.float64) * [1, 1, -1]  # toes behind: by shape left were right
    assert known_bones(renamed(HUMANOID, names, backwards)) == HUMANOID.config.vrm


@pytest.mark.parametrize("has_fingers", [True, False], ids=["fingers", "no fingers"])
@pytest.mark.parametrize("shares", [(0.5,), (1 / 3, 2 / 3), (0.25, 0.5, 0.75)])
def test_twist_joints_between_the_bones_are_not_taken_for_them(shares, has_fingers):
    config = HUMANOID.config
    hands = {HUMANOID.index(f"{side}Hand") for side in ("left", "right")}
    new: dict[int, int] = {}
    parents: list[int] = []
    places: list[np.ndarray] = []
    for joint, bone in enumerate(config.names):
        parent = config.parents[joint]
        if parent >= 0 and (parent not in new or (parent in hands and not has_fingers)):
            continue
        above = new.get(parent, -1)
        if bone.endswith(("LowerArm", "Hand", "LowerLeg")):
            start, end = HUMANOID.rest_positions[parent], HUMANOID.rest_positions[joint]
            for share in shares:
                parents.append(above)
                places.append(start + share * (end - start))
                above = len(parents) - 1
        parents.append(above)
        places.append(HUMANOID.rest_positions[joint])
        new[joint] = len(parents) - 1
    tree = Tree([f"bone_{k}" for k in range(len(parents))], parents, np.array(places, np.float64))
    found = shaped_bones(tree)
    assert {bone: found.get(bone) for bone in REQUIRED} == {bone: new[HUMANOID.index(bone)] for bone in REQUIRED}
