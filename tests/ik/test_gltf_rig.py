"""Rigs of characters with rest poses, scales and facings of their own, read as skeletons without."""

import numpy as np
import pytest
from tests.exports.bodies import CHILD, MIXAMO, child, long_armed

from echoavatar.ik.gltf_rig import read_gltf_rig
from echoavatar.kinematics import HUMANOID


def test_a_scaled_armature_with_turned_bones_is_read_in_metres(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.glb"
    path.write_bytes(long_armed())
    rig = read_gltf_rig(path)
    assert not rig.is_turned
    assert len(rig.order) == HUMANOID.joints
    bones, rest = rig.skeleton.config.vrm, rig.skeleton.rest_positions.numpy()
    assert rig.skeleton.names[bones["leftHand"]] == MIXAMO["leftHand"]
    arm = np.linalg.norm(rest[bones["leftHand"]] - rest[bones["leftLowerArm"]])
    assert arm == pytest.approx(1.45 * 0.245, abs=1e-4)
    assert rest[bones["leftHand"], 1] < rest[bones["leftUpperArm"], 1] - 0.3  # an A-pose


def test_a_character_that_faces_away_is_turned_round(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.vrm"
    path.write_bytes(child())
    rig = read_gltf_rig(path)
    assert rig.is_turned
    bones, offsets = rig.skeleton.config.vrm, rig.skeleton.offsets.numpy()
    assert set(bones) == set(HUMANOID.names)
    for joint, name in enumerate(HUMANOID.names):
        np.testing.assert_allclose(offsets[bones[name]], CHILD[joint], atol=1e-5, err_msg=name)
