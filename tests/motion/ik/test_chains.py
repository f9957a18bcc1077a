import torch

from echoavatar.motion.ik.chains import Chains
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import (
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_matrix,
)


def test_frames_are_those_of_forward_kinematics() -> None:
    turns = torch.randn(11, HUMANOID.joints, 3, generator=torch.Generator().manual_seed(0))
    turns[:, 0] = 0
    rotations = matrix_from_axis_angle(turns)
    wanted = HUMANOID.indices(["head", "leftIndexDistal", "leftThumbDistal", "rightHand"])
    chains = Chains(HUMANOID, wanted)
    quaternions = quaternion_from_matrix(rotations)[None].numpy()
    ours = chains.pose(quaternions)
    pose = forward_kinematics(HUMANOID, rotations, torch.zeros(11, 3))
    turned = matrix_from_quaternion(torch.from_numpy(ours.rotations[0]))
    torch.testing.assert_close(turned, pose.rotations[:, chains.joints], atol=1e-5, rtol=0)
    places = torch.from_numpy(ours.places[0])
    torch.testing.assert_close(places, pose.positions[:, chains.joints], atol=1e-5, rtol=0)


def test_the_root_stands_at_the_origin_and_only_what_is_needed_is_worked_out() -> None:
    chains = Chains(HUMANOID, [HUMANOID.index("head")])
    assert chains.joints[0] == 0
    assert HUMANOID.index("leftFoot") not in chains.joints
    turned = torch.zeros(1, HUMANOID.joints, 3)
    turned[0, 0, 1] = 1.0
    pose = chains.pose(quaternion_from_matrix(matrix_from_axis_angle(turned))[None].numpy())
    assert pose.rotations[0, 0, 0].tolist() == [1, 0, 0, 0]
    assert pose.places[0, 0, 0].tolist() == [0, 0, 0]
