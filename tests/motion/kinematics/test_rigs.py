"""Joints of any rig are recognised: by names, by the shape of the body, by a map of the user's."""

import numpy as np
import pytest
from tests.motion.kinematics.naming import FRAMED, SCHEMES, body, every_body
from tests.motion.kinematics.samples import chain, recorded

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID, Skeleton
from echoavatar.motion.kinematics.rigs import REQUIRED, bone_map, finger_bones, known_bones

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
