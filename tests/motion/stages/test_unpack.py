import numpy as np
import pytest
import torch

from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig, to_features
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_axis_angle, matrix_from_quaternion
from echoavatar.motion.stages.unpack import Unpacking


def bodies(rows: int = 3, frames: int = 8) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    turns = torch.randn(rows, frames, HUMANOID.joints, 3, generator=generator)
    return matrix_from_axis_angle(turns), torch.randn(rows, frames, 3, generator=generator)


@pytest.mark.parametrize("frames", [8, 3])
def test_features_become_the_rotations_they_were_made_of(frames: int) -> None:
    """Outside witness: `to_features`, there and back."""
    rotations, root = bodies(frames=frames)
    features = to_features(HUMANOID, rotations, root)
    pose, is_good = Unpacking(HUMANOID).pose_of(features.numpy(), 30.0)
    shown, travel = pose.rotations, pose.root
    assert is_good
    assert shown.shape == (3, frames, HUMANOID.joints, 4)
    assert angle_between(matrix_from_quaternion(torch.from_numpy(shown)), rotations).max() < 2e-3
    decoded = features[..., travel_slice(HUMANOID)].numpy()
    np.testing.assert_array_equal(travel, decoded[..., [0, 2, 1]])  # across, height, along


def test_joints_without_features_rest() -> None:
    parts = {"lower": HUMANOID.config.parts["lower"]}
    rig = Skeleton(HUMANOID.config.model_copy(update={"parts": parts}))
    rotations, root = bodies()
    pose, _ = Unpacking(rig).pose_of(to_features(rig, rotations, root).numpy(), 30.0)
    shown = pose.rotations
    others = [joint for joint in range(rig.joints) if joint not in parts["lower"]]
    assert (shown[:, :, others] == [1, 0, 0, 0]).all()
    lower = list(parts["lower"])
    turned = matrix_from_quaternion(torch.from_numpy(shown[:, :, lower]))
    assert angle_between(turned, rotations[:, :, lower]).max() < 2e-3


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("channel", [0, 100, 314, "height"])
def test_garbage_anywhere_is_noticed(value: float, channel: int | str) -> None:
    features = to_features(HUMANOID, *bodies())
    at = travel_slice(HUMANOID).stop - 1 if channel == "height" else int(channel)
    features[1, 5, at] = value
    _, is_good = Unpacking(HUMANOID).pose_of(features.numpy(), 30.0)
    assert not is_good


def chain(joints: int, parts: dict[str, tuple[int, ...]]) -> Skeleton:
    """Bones of 10 cm, one above the other."""
    offsets = ((0.0, 0.1, 0.0),) * joints
    names, parents = tuple(f"bone{joint}" for joint in range(joints)), tuple(range(-1, joints - 1))
    return Skeleton(SkeletonConfig(names=names, parents=parents, offsets=offsets, parts=parts))


@pytest.mark.parametrize("joints", [1, 2, 5])
@pytest.mark.parametrize("frames", [8, 5])
def test_no_joint_of_a_small_rig_is_lost(joints: int, frames: int) -> None:
    rig = chain(joints, {"lower": tuple(range(joints))})
    turns = torch.randn(2, frames, joints, 3, generator=torch.Generator().manual_seed(joints))
    rotations = matrix_from_axis_angle(turns)
    pose, is_good = Unpacking(rig).pose_of(to_features(rig, rotations, torch.zeros(2, frames, 3)).numpy(), 30.0)
    shown = pose.rotations
    assert is_good
    assert angle_between(matrix_from_quaternion(torch.from_numpy(shown)), rotations).max() < 2e-3
