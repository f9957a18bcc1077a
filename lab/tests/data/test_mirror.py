import pytest
import torch

from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from echoavatar_lab.data.mirror import (
    is_symmetric,
    mirror_features,
    mirror_positions,
    mirror_quaternions,
    mirror_rotations,
)


def random_clip():
    generator = torch.Generator().manual_seed(0)
    quaternions = torch.nn.functional.normalize(torch.randn(6, 52, 4, generator=generator).double(), dim=-1)
    return quaternions, torch.randn(6, 3, generator=generator).double()


def test_mirrored_pose_is_the_mirror_image_of_the_pose():
    quaternions, root = random_clip()
    rotations = matrix_from_quaternion(quaternions)
    plain = forward_kinematics(HUMANOID, rotations, root).positions
    other = forward_kinematics(HUMANOID, mirror_rotations(HUMANOID, rotations), mirror_positions(root)).positions
    torch.testing.assert_close(other, mirror_positions(plain)[:, list(HUMANOID.config.mirror)])


def test_twice_is_nothing():
    quaternions, root = random_clip()
    rotations = matrix_from_quaternion(quaternions)
    assert torch.equal(mirror_rotations(HUMANOID, mirror_rotations(HUMANOID, rotations)), rotations)
    features = to_features(HUMANOID, rotations, root)
    assert torch.equal(mirror_features(HUMANOID, mirror_features(HUMANOID, features)), features)


def test_all_forms_agree():
    quaternions, root = random_clip()
    rotations = matrix_from_quaternion(quaternions)
    mirrored = mirror_rotations(HUMANOID, rotations)
    alike = (mirror_quaternions(HUMANOID, quaternions) * quaternion_from_matrix(mirrored)).sum(-1).abs()
    torch.testing.assert_close(alike, torch.ones_like(alike))
    torch.testing.assert_close(
        mirror_features(HUMANOID, to_features(HUMANOID, rotations, root)),
        to_features(HUMANOID, mirrored, mirror_positions(root)),
    )


def test_our_rig_mirrors_and_a_lopsided_one_is_told():
    assert is_symmetric(HUMANOID)
    offsets = list(HUMANOID.config.offsets)
    offsets[HUMANOID.index("leftHand")] = (0.3, 0.0, 0.0)
    assert not is_symmetric(Skeleton(HUMANOID.config.model_copy(update={"offsets": tuple(offsets)})))


def test_a_rig_without_pairs_is_refused():
    with pytest.raises(ValueError, match="mirror pairs"):
        mirror_rotations(Skeleton(HUMANOID.config.model_copy(update={"mirror": ()})), torch.eye(3).expand(52, 3, 3))
