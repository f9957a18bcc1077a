import numpy as np
import torch

from echoavatar.motion.kinematics.easing import falloff, smootherstep


def test_a_step_has_no_speed_and_no_acceleration_at_its_ends() -> None:
    share = torch.tensor([0.0, 0.5, 1.0], dtype=torch.double, requires_grad=True)
    value = smootherstep(share)
    (speed,) = torch.autograd.grad(value.sum(), share, create_graph=True)
    (acceleration,) = torch.autograd.grad(speed.sum(), share)
    torch.testing.assert_close(value, share)
    torch.testing.assert_close(speed, torch.tensor([0, 1.875, 0]).double())
    torch.testing.assert_close(acceleration, torch.zeros(3).double())
    np.testing.assert_array_equal(smootherstep(np.array([0.0, 0.5, 1.0])), [0, 0.5, 1])


def test_a_falloff_is_whole_up_to_the_near_end_and_gone_from_the_far_one() -> None:
    assert falloff(torch.tensor([0.0, 1.0, 2.0, 3.0, 4.0]), 1.0, 3.0).tolist() == [1, 1, 0.5, 0, 0]
