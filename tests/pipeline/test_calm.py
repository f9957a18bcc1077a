import math

import numpy as np
import pytest
import torch
from tests.pipeline.poses import everyone, from_quaternions, in_pieces, quaternions_of

from echoavatar.kinematics.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle
from echoavatar.pipeline.calm import STIFFNESS, Calm, CalmState


def about_x(angle: torch.Tensor) -> torch.Tensor:
    """(1, t, 2, 4): the first joint turns by `angle` (t,) about X, the second rests."""
    turns = torch.zeros(1, len(angle), 2, 3)
    turns[0, :, 0, 0] = angle
    return quaternion_from_axis_angle(turns)


def step(
    calm: Calm, rotations: torch.Tensor, state: CalmState, active: np.ndarray | None = None
) -> torch.Tensor:
    on = everyone(len(rotations)) if active is None else active

    def chunk(part: torch.Tensor) -> torch.Tensor:
        pose = from_quaternions(part, torch.zeros(*part.shape[:2], 3))
        calm.step(pose, state, on)
        return quaternions_of(pose)

    return in_pieces(chunk, rotations)


def angle_of(rotations: torch.Tensor) -> torch.Tensor:
    return axis_angle_from_quaternion(rotations)[0, :, 0, 0]


def shown(angle: torch.Tensor, **options: float) -> torch.Tensor:
    calm = Calm(2, **options)
    return angle_of(step(calm, about_x(angle), calm.init_state(1)))


def test_steps_between_latents_become_a_smooth_path() -> None:
    """A rotation that steps by chance every 4 frames, as noisy codes decode: the jerk falls by more than 5."""
    torch.manual_seed(0)
    steps = (0.05 * torch.randn(40)).repeat_interleave(4)
    path = shown(steps)
    assert torch.diff(path, n=3).abs().mean() < torch.diff(steps, n=3).abs().mean() / 5
    assert (path - steps).abs().mean() < 0.05


@pytest.mark.parametrize("frames", [8, 5, 3])
def test_a_chunk_is_the_minimum_that_the_formula_asks_for(frames: int) -> None:
    """Outside witness: least squares in double precision, every chunk on top of the last three frames shown."""
    torch.manual_seed(1)
    decoded = torch.nn.functional.normalize(
        torch.tensor([1.0, 0.3, 0.2, 0.1]) + 0.03 * torch.randn(24, 4), dim=-1
    )
    calm = Calm(1)
    state, path = calm.init_state(1), [decoded[0].double().numpy()] * 3
    for chunk in decoded.split(frames):
        t = len(chunk)
        third = np.diff(np.eye(3 + t), n=3, axis=0)
        left = np.concatenate([np.diag(((np.arange(t) + 1) / t) ** 2), math.sqrt(STIFFNESS) * third[:, 3:]])
        right = np.concatenate(
            [left[:t] @ chunk.double().numpy(), -math.sqrt(STIFFNESS) * third[:, :3] @ np.array(path[-3:])]
        )
        found = np.linalg.lstsq(left, right, rcond=None)[0]
        path.extend(found / np.linalg.norm(found, axis=1, keepdims=True))
        pose = from_quaternions(chunk[None, :, None], torch.zeros(1, t, 3))
        calm.step(pose, state, everyone(1))
        np.testing.assert_allclose(quaternions_of(pose)[0, :, 0], path[-t:], atol=1e-5)


def test_a_quick_stroke_keeps_its_time_and_size() -> None:
    """Sweeps of 1.2 rad in 0.4 s, as arms make them: a tenth of the way off at most."""
    time = torch.arange(64) / 30
    stroke = 1.2 * torch.sin(2 * math.pi * time / 0.8)
    assert (shown(stroke) - stroke)[8:].abs().max() < 0.12


def test_no_stiffness_shows_what_was_decoded() -> None:
    torch.manual_seed(0)
    angle = 0.5 * torch.rand(32)
    torch.testing.assert_close(shown(angle, stiffness=0.0), angle, atol=1e-5, rtol=0)


def test_a_jump_at_a_chunk_border_is_bridged() -> None:
    """Half a radian between two frames becomes a path whose acceleration is a fraction of the jump's."""
    jump = torch.cat([torch.zeros(16), torch.full((24,), 0.5)])
    path = shown(jump)
    assert torch.diff(path, n=2).abs().max() < 0.4 * torch.diff(jump, n=2).abs().max()
    assert path[-1] == pytest.approx(0.5, abs=0.01)


def test_no_joint_turns_faster_than_the_bound() -> None:
    """A jump of 3 rad is spread: 1,000 degrees a second are 0.582 rad a frame."""
    jump = torch.cat([torch.zeros(8), torch.full((24,), 3.0)])
    path = shown(jump)
    assert (path[1:] - path[:-1]).abs().max() <= math.radians(1000) / 30 + 1e-4
    assert path[-1] == pytest.approx(3.0, abs=0.05)


def test_the_sign_of_a_quaternion_does_not_matter() -> None:
    smooth = about_x(torch.linspace(0, 1, 16))
    flipped = smooth.clone()
    flipped[:, ::2] *= -1
    calm = Calm(2)
    one, other = (angle_of(step(calm, x, calm.init_state(1))) for x in (smooth, flipped))
    torch.testing.assert_close(one, other)


def test_idle_rows_stay_untouched() -> None:
    calm = Calm(2)
    state = calm.init_state(2)
    step(calm, about_x(torch.ones(8)).expand(2, -1, -1, -1), state, np.array([True, False]))
    assert all(not tensor[1].any() for tensor in state.tensors())
