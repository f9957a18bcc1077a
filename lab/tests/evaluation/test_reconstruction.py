import pytest
import torch

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar_lab.evaluation.reconstruction import codebook_use, reconstruction


def still(frames: int = 4) -> torch.Tensor:
    return torch.eye(3).expand(frames, HUMANOID.joints, 3, 3).clone()


def test_turning_the_whole_body_is_no_pose_error() -> None:
    turned = still()
    turned[:, 0] = matrix_from_axis_angle(torch.tensor([0.0, 1.2, 0.0]))
    result = reconstruction(HUMANOID, still(), turned, torch.zeros(4, 2), torch.zeros(4, 2))
    assert result.mpjpe_body_mm == pytest.approx(0, abs=1e-3)


def test_a_turned_wrist_moves_no_body_joint_and_counts_for_the_fingers() -> None:
    """Both wrists turned: 22 body joints stay, all 30 finger joints move."""
    turned = still()
    for side in ("left", "right"):
        turned[:, HUMANOID.index(f"{side}Hand")] = matrix_from_axis_angle(torch.tensor([0.5, 0.0, 0.0]))
    result = reconstruction(HUMANOID, still(), turned, torch.zeros(4, 2), torch.zeros(4, 2))
    assert result.mpjpe_body_mm == pytest.approx(0, abs=1e-3)
    assert result.mpjpe_hands_mm > 5


def test_velocity_error_is_the_length_of_the_difference() -> None:
    """(3, 4) mm a frame off is 5 mm."""
    off = torch.tensor([[0.003, 0.004]]).expand(4, 2)
    assert reconstruction(HUMANOID, still(), still(), torch.zeros(4, 2), off).root_velocity_mm == pytest.approx(5)


def test_use_counts_distinct_codes() -> None:
    codes = torch.tensor([[[0, 1]], [[0, 2]], [[1, 3]]])
    assert torch.allclose(codebook_use(codes, 4), torch.tensor([[0.5, 0.75]]))
