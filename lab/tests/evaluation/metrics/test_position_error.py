import pytest
import torch

from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar_lab.evaluation.metrics.position_error import heading, mean_joint_error, trans_loss, without_heading


def test_heading_is_the_yaw_that_is_taken_out() -> None:
    turned = matrix_from_axis_angle(torch.tensor([[[0.0, 1.2, 0.0], [0.3, 0.0, 0.0]]]))
    assert float(heading(turned[:, 0])) == pytest.approx(1.2)
    facing = without_heading(turned)
    torch.testing.assert_close(facing[:, 0], torch.eye(3)[None])
    torch.testing.assert_close(facing[:, 1], turned[:, 1])


def test_a_bow_is_kept_when_heading_goes() -> None:
    """Turned by 2 rad, then bent by 0.4 about its own side: the bend stays."""
    turn, bow = (matrix_from_axis_angle(torch.tensor([v])) for v in ([0.0, 2.0, 0.0], [0.4, 0.0, 0.0]))
    torch.testing.assert_close(without_heading((turn @ bow)[:, None])[:, 0], bow, atol=1e-6, rtol=0)


def test_errors_are_means_of_lengths() -> None:
    """One joint of two is 5 cm off."""
    true = torch.zeros(4, 2, 3)
    made = true.clone()
    made[:, 0] = torch.tensor([0.03, 0.0, 0.04])
    assert mean_joint_error(made, true) == pytest.approx(0.025)


def test_the_two_norms_of_the_root() -> None:
    made = torch.tensor([[0.003, 0.004]])
    assert trans_loss(made, torch.zeros(1, 2)) == pytest.approx(0.005)
    assert trans_loss(made, torch.zeros(1, 2), "l1") == pytest.approx(0.007)
