import numpy as np
import torch

from echoavatar.ik.chains import Chains, Points
from echoavatar.kinematics import HUMANOID, forward_kinematics
from echoavatar.kinematics.rotations import matrix_from_axis_angle


def test_frames_are_those_of_forward_kinematics() -> None:
    turns = torch.randn(5, HUMANOID.joints, 3, generator=torch.Generator().manual_seed(0))
    turns[:, 0] = 0
    rotations = matrix_from_axis_angle(turns)
    wanted = HUMANOID.indices(["head", "leftIndexDistal", "leftThumbDistal", "rightHand"])
    chains = Chains(HUMANOID, wanted)
    frames = chains.world(chains.local(rotations.numpy()))
    pose = forward_kinematics(HUMANOID, rotations, torch.zeros(5, 3))
    ours = torch.from_numpy(frames).permute(3, 2, 0, 1)
    torch.testing.assert_close(ours[..., :3], pose.rotations[:, chains.joints], atol=1e-5, rtol=0)
    torch.testing.assert_close(ours[..., 3], pose.positions[:, chains.joints], atol=1e-5, rtol=0)
    assert HUMANOID.index("leftFoot") not in chains.joints


def test_points_ride_on_their_joints() -> None:
    chains = Chains(HUMANOID, [HUMANOID.index("head")])
    rotations = np.tile(np.eye(3, dtype=np.float32), (2, HUMANOID.joints, 1, 1))
    rotations[1, HUMANOID.index("neck")] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # ahead becomes left
    head = Points(
        np.array([chains.slot[HUMANOID.index("head")]]), np.array([[0.0], [0.1], [0.05]], np.float32)
    )
    placed = head.place(chains.world(chains.local(rotations)))
    rest = (HUMANOID.rest_positions - HUMANOID.rest_positions[0]).numpy()
    at = rest[HUMANOID.index("head")]
    np.testing.assert_allclose(placed[:, 0, 0], at + [0, 0.1, 0.05], atol=1e-6)
    neck = rest[HUMANOID.index("neck")]
    np.testing.assert_allclose(placed[:, 0, 1], neck + [0.020 + 0.05, 0.095 + 0.1, 0], atol=1e-6)
