import torch

from echoavatar.ik.chains import Chains
from echoavatar.kinematics import HUMANOID, forward_kinematics
from echoavatar.kinematics.rotations import matrix_from_axis_angle, quaternion_from_matrix
from echoavatar.nn.octet import blocks


def test_frames_are_those_of_forward_kinematics() -> None:
    turns = torch.randn(11, HUMANOID.joints, 3, generator=torch.Generator().manual_seed(0))
    turns[:, 0] = 0
    rotations = matrix_from_axis_angle(turns)
    wanted = HUMANOID.indices(["head", "leftIndexDistal", "leftThumbDistal", "rightHand"])
    chains = Chains(HUMANOID, wanted)
    frames = chains.world(blocks(quaternion_from_matrix(rotations).permute(1, 2, 0).numpy()))
    assert frames.shape == (2, len(chains.joints), 12, 8)  # 11 frames, the last one repeated
    pose = forward_kinematics(HUMANOID, rotations, torch.zeros(11, 3))
    ours = torch.from_numpy(frames).permute(0, 3, 1, 2).flatten(0, 1)[:11].unflatten(-1, (3, 4))
    torch.testing.assert_close(ours[..., :3], pose.rotations[:, chains.joints], atol=1e-5, rtol=0)
    torch.testing.assert_close(ours[..., 3], pose.positions[:, chains.joints], atol=1e-5, rtol=0)


def test_the_root_stands_at_the_origin_and_only_what_is_needed_is_worked_out() -> None:
    chains = Chains(HUMANOID, [HUMANOID.index("head")])
    assert chains.joints[0] == 0
    assert HUMANOID.index("leftFoot") not in chains.joints
    turned = torch.zeros(1, HUMANOID.joints, 3)
    turned[0, 0, 1] = 1.0
    turns = blocks(quaternion_from_matrix(matrix_from_axis_angle(turned)).permute(1, 2, 0).numpy())
    root = chains.world(turns)[0, 0, :, 0].reshape(3, 4)
    assert root.tolist() == [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]
