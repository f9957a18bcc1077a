from typing import Any

import numpy as np
import pytest
import torch
from tests.laws import streaming

from echoavatar.kinematics import HUMANOID, from_features, to_features
from echoavatar.kinematics.features import travel_slice
from echoavatar.pipeline.retime import LARGEST_LAG, Retime

GROUND = slice(travel_slice(HUMANOID).start, travel_slice(HUMANOID).start + 2)


def turning(frames: int, rows: int = 1) -> torch.Tensor:
    """Features of a body that walks 2 cm a frame along x and turns its whole self by 2 degrees a frame."""
    angle = torch.deg2rad(2.0 * torch.arange(frames))
    rotations = torch.eye(3).repeat(frames, HUMANOID.joints, 1, 1)
    rotations[:, 0, 0, 0] = rotations[:, 0, 2, 2] = angle.cos()
    rotations[:, 0, 0, 2], rotations[:, 0, 2, 0] = angle.sin(), -angle.sin()
    root = HUMANOID.offsets[0].repeat(frames, 1)
    root[:, 0] += 0.02 * torch.arange(frames)
    return to_features(HUMANOID, rotations, root)[None].repeat(rows, 1, 1)


def played(features: torch.Tensor, brake: torch.Tensor) -> torch.Tensor:
    retime = Retime(HUMANOID)
    rows = len(features)
    state, everyone = retime.init_state(rows), torch.ones(rows, dtype=torch.bool)
    parts = zip(features.split(8, 1), brake.split(8, 1), strict=True)
    return torch.cat([retime.step(x, b, state, everyone) for x, b in parts], 1)


def test_with_nothing_to_brake_for_motion_passes_as_it_is() -> None:
    features = turning(48)
    torch.testing.assert_close(played(features, torch.zeros(1, 48)), features, atol=1e-6, rtol=0)


def test_a_dip_slows_the_body_there_and_is_made_up_for() -> None:
    """The witness is the path: the angle shown tells which decoded frame it is; the root must be at the same one."""
    frames, at = 96, np.arange(96)
    brake = np.exp(-0.5 * ((at - 40) / 2.0) ** 2).astype(np.float32)
    shown = from_features(HUMANOID, played(turning(frames), torch.from_numpy(brake)[None])[0])
    angle = torch.rad2deg(torch.atan2(shown.rotations[:, 0, 0, 2], shown.rotations[:, 0, 0, 0])).numpy()
    frame_shown = np.unwrap(angle, period=360) / 2
    pace = np.diff(frame_shown)
    assert pace.min() == pytest.approx(0.05, abs=0.12)
    assert abs(int(pace.argmin()) + 0.5 - 40) <= 1.5
    assert (pace >= -1e-3).all()  # time never runs backwards
    assert pace.max() <= 1.6 + 1e-3
    lag = at - frame_shown
    assert 3 < lag.max() <= LARGEST_LAG
    assert lag[:30] == pytest.approx(0, abs=1e-3)
    assert lag[-1] < 0.05
    root = shown.root[:, 0].numpy() - float(HUMANOID.offsets[0, 0])
    np.testing.assert_allclose(root, 0.02 * frame_shown, atol=2e-3)


def test_the_lag_has_a_bound_and_a_session_that_begins_braking_shows_its_first_frame() -> None:
    shown = played(turning(64), torch.ones(1, 64))
    assert torch.equal(shown[:, 0], turning(64)[:, 0])
    paces = shown[0, 24:, GROUND].norm(dim=1) / 0.02  # behind by the bound: as fast as decoded
    torch.testing.assert_close(paces, torch.ones_like(paces), atol=1e-4, rtol=0)


class OneInput:
    """Features and brake side by side, as the laws want them."""

    def __init__(self) -> None:
        self.retime = Retime(HUMANOID)

    def init_state(self, rows: int) -> Any:
        return self.retime.init_state(rows)

    def step(self, x: torch.Tensor, state: Any, active: torch.Tensor) -> torch.Tensor:
        return self.retime.step(x[..., :-1], x[..., -1], state, active)

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        return self.step(x, self.init_state(len(x)), torch.ones(len(x), dtype=torch.bool))


def test_it_streams() -> None:
    def motion(rows: int, frames: int, generator: torch.Generator) -> torch.Tensor:
        features = 0.1 * torch.randn(rows, frames, 315, generator=generator)
        return torch.cat([features, torch.rand(rows, frames, 1, generator=generator)], 2)

    streaming.hold(OneInput(), motion, unit=2, atol=1e-5)
