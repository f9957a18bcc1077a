"""A body whose names say nothing is read by its shape."""

import numpy as np
import pytest
from tests.motion.kinematics.naming import EXTRA, body, every_body, renamed
from tests.motion.kinematics.samples import recorded

from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.joint_tree import REQUIRED
from echoavatar.motion.kinematics.rigs import known_bones

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
