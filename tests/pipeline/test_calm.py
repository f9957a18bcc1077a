import math

import pytest
import torch

from echoavatar.kinematics.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle
from echoavatar.pipeline.calm import Calm

ON = torch.ones(1, dtype=torch.bool)


def about_x(angle: torch.Tensor) -> torch.Tensor:
    """(1, t, 2, 4): the first joint turns by `angle` (t,) about X, the second rests."""
    turns = torch.zeros(1, len(angle), 2, 3)
    turns[0, :, 0, 0] = angle
    return quaternion_from_axis_angle(turns)


def angle_of(rotations: torch.Tensor) -> torch.Tensor:
    return axis_angle_from_quaternion(rotations)[0, :, 0, 0]


def shown(angle: torch.Tensor) -> torch.Tensor:
    calm = Calm(2)
    return angle_of(calm.step(about_x(angle), calm.init_state(1), ON, 30.0))


def test_trembling_is_damped() -> None:
    """Alternating by 0.02 rad: following half the way each frame leaves a third of it."""
    trembling = torch.tensor([0.01, -0.01]).repeat(40)
    assert shown(trembling)[20:].abs().max() < 0.0055


def test_a_quick_stroke_keeps_its_time() -> None:
    time = torch.arange(60) / 30
    stroke = 1.2 * torch.sin(2 * math.pi * time / 0.8)
    assert (shown(stroke) - stroke).abs().max() < 0.06


def test_no_joint_turns_faster_than_the_bound() -> None:
    """A jump of 3 rad is spread: 1,000 degrees a second are 0.582 rad a frame."""
    jump = torch.cat([torch.zeros(5), torch.full((20,), 3.0)])
    path = shown(jump)
    assert (path[1:] - path[:-1]).abs().max() <= math.radians(1000) / 30 + 1e-4
    assert path[-1] == pytest.approx(3.0, abs=0.01)


def test_the_sign_of_a_quaternion_does_not_matter() -> None:
    smooth = about_x(torch.linspace(0, 1, 20))
    flipped = smooth.clone()
    flipped[:, ::2] *= -1
    calm = Calm(2)
    one, other = (angle_of(calm.step(x, calm.init_state(1), ON, 30.0)) for x in (smooth, flipped))
    torch.testing.assert_close(one, other)


@pytest.mark.parametrize("cuts", [[8, 8, 8], [1, 22, 1]])
def test_any_chunking_gives_the_whole(cuts: list[int]) -> None:
    torch.manual_seed(0)
    rotations = about_x(torch.randn(24))
    calm = Calm(2)
    state = calm.init_state(1)
    parts = torch.cat([calm.step(piece, state, ON, 30.0) for piece in rotations.split(cuts, 1)], 1)
    torch.testing.assert_close(parts, calm.step(rotations, calm.init_state(1), ON, 30.0))


def test_idle_rows_stay_untouched() -> None:
    calm = Calm(2)
    state = calm.init_state(2)
    calm.step(about_x(torch.ones(8)).expand(2, -1, -1, -1), state, torch.tensor([True, False]), 30.0)
    assert all(not tensor[1].any() for tensor in state.tensors())
