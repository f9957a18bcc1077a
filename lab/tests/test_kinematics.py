"""The torch kinematics of training against the avatar's, and its gradients."""

import numpy as np
import pytest
import torch

from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig, features, motion, rotations, to_features
from echoavatar_lab import kinematics

RANDOM = np.random.default_rng(0)
TURNS = rotations.matrix_from_quaternion(RANDOM.standard_normal((3, 5, 52, 4)))
ROOT = RANDOM.standard_normal((3, 5, 3))
QUATERNIONS = np.concatenate([RANDOM.standard_normal((50, 4)), np.eye(4), -np.eye(4)])
VECTORS = np.concatenate([RANDOM.standard_normal((50, 3)), np.zeros((1, 3)), 1e-9 * np.eye(3)])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("matrix_to_6d", TURNS),
        ("matrix_from_6d", RANDOM.standard_normal((50, 6))),
        ("matrix_from_quaternion", QUATERNIONS),
        ("quaternion_from_matrix", TURNS),
        ("matrix_from_axis_angle", VECTORS),
        ("quaternion_from_axis_angle", VECTORS),
    ],
)
def test_rotations_are_those_of_the_avatar(name, given, dtype):
    """Within 1e-6; the quaternions of half turns may differ in sign."""
    ours = getattr(kinematics, name)(torch.from_numpy(given.astype(dtype))).numpy()
    theirs = getattr(rotations, name)(given.astype(dtype))
    assert ours.dtype == theirs.dtype == dtype
    np.testing.assert_allclose(ours, theirs, atol=1e-6, rtol=0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_poses_and_features_are_those_of_the_avatar(dtype):
    turns, root = TURNS.astype(dtype), ROOT.astype(dtype)
    ours = kinematics.forward_kinematics(HUMANOID, torch.from_numpy(turns), torch.from_numpy(root))
    for own, wanted in zip(ours, motion.forward_kinematics(HUMANOID, turns, root), strict=True):
        np.testing.assert_allclose(own.numpy(), wanted, atol=1e-6, rtol=0)
    given = to_features(HUMANOID, turns, root)
    found = kinematics.from_features(HUMANOID, torch.from_numpy(given))
    for own, wanted in zip(found, features.from_features(HUMANOID, given), strict=True):
        np.testing.assert_allclose(own.numpy(), wanted, atol=1e-6, rtol=0)


def test_gradients_of_the_pose_are_the_true_ones():
    chain = [HUMANOID.index(name) for name in ("hips", "leftUpperLeg", "leftLowerLeg", "leftFoot", "leftToes")]
    offsets = tuple(HUMANOID.config.offsets[joint] for joint in chain)
    small = Skeleton(SkeletonConfig(names=tuple("abcde"), parents=(-1, 0, 1, 2, 3), offsets=offsets))
    inputs = [torch.from_numpy(part[0, :1]).requires_grad_() for part in (TURNS[:, :, chain], ROOT)]
    assert torch.autograd.gradcheck(lambda r, p: kinematics.forward_kinematics(small, r, p).positions, inputs)


def test_gradients_are_finite_at_rest():
    six = torch.tensor([1.0, 0, 0, 0, 1, 0], requires_grad=True)
    kinematics.matrix_from_6d(six).sum().backward()
    vector = torch.zeros(3, requires_grad=True)
    kinematics.matrix_from_axis_angle(vector).sum().backward()
    assert torch.isfinite(six.grad).all()
    assert torch.isfinite(vector.grad).all()
