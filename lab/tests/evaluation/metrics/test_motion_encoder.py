from pathlib import Path

import numpy as np
import pytest
import torch
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.metrics.distributions import frechet_distance
from echoavatar_lab.evaluation.metrics.motion_encoder import (
    TRAVEL,
    MotionEncoder,
    MotionEncoderConfig,
    feature_count,
    load_shipped,
    motion_features,
)
from echoavatar_lab.tables.baselines import facing


@pytest.fixture
def model() -> MotionEncoder:
    torch.manual_seed(0)
    return MotionEncoder(MotionEncoderConfig(features=5, width=8, latent=3)).eval()


def clip(frames: int, size: float = 0.3) -> torch.Tensor:
    motion = swaying(frames, size=size)
    return motion_features(torch.from_numpy(motion.rotations), torch.from_numpy(motion.root))


def test_one_latent_for_eight_frames(model: MotionEncoder) -> None:
    assert model.features(torch.randn(83, 5)).shape == (10, 3)
    assert model(torch.randn(2, 64, 5)).shape == (2, 64, 5)


def test_latents_get_unit_spread(model: MotionEncoder) -> None:
    clips = [torch.randn(80, 5) for _ in range(4)]
    model.set_latent_statistics(clips)
    latents = torch.cat([model.features(one) for one in clips])
    torch.testing.assert_close(latents.mean(0), torch.zeros(3), atol=1e-4, rtol=0)
    torch.testing.assert_close(latents.std(0), torch.ones(3), atol=1e-3, rtol=0)


def test_it_comes_back_from_disk_in_half_precision(model: MotionEncoder, tmp_path: Path) -> None:
    model.save(tmp_path, {"data": "none"})
    x = torch.randn(16, 5)
    torch.testing.assert_close(MotionEncoder.load(tmp_path).features(x), model.features(x), atol=1e-2, rtol=0)
    with pytest.raises(CheckpointError):
        MotionEncoder.load(tmp_path / "none")


@pytest.mark.parametrize("shape", [(7, 5), (16, 4)])
def test_a_clip_that_does_not_fit_is_refused(model: MotionEncoder, shape: tuple[int, int]) -> None:
    with pytest.raises(MotionError, match="longer one"):
        model.features(torch.zeros(shape))


def test_the_shipped_one_tells_a_livelier_body_apart() -> None:
    """Distance to a body that sways more grows with how much more."""
    model = load_shipped()
    own, same, more, wild = (model.features(clip(240, size)).double().numpy() for size in (0.1, 0.1, 0.15, 0.3))
    near, far = frechet_distance(more, own), frechet_distance(wild, own)
    assert frechet_distance(same, own) < 0.01 * near
    assert near < far
    assert np.isfinite(far)


def features(rotations: np.ndarray, root: np.ndarray) -> torch.Tensor:
    return motion_features(torch.from_numpy(rotations), torch.from_numpy(root))


def test_features_ignore_place_and_heading() -> None:
    clip = swaying()
    turned, root = facing(clip.rotations, clip.root, 2.0)
    own, other = features(clip.rotations, clip.root), features(turned, root + np.float32([3, 0, -1]))
    assert own.shape == (60, feature_count(HUMANOID.joints))
    torch.testing.assert_close(own, other, atol=2e-4, rtol=0)


def test_travel_is_seen_from_the_body() -> None:
    """A body that faces its own left (+X) and walks there at 0.6 m/s walks ahead."""
    frames = 10
    rotations = np.zeros((frames, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    rotations[:, 0] = [np.sqrt(0.5), 0, np.sqrt(0.5), 0]
    root = np.zeros((frames, 3), np.float32)
    root[:, 0], root[:, 1] = np.arange(frames) * 0.02, 0.9
    travel = features(rotations, root)[:, -TRAVEL:]
    expected = torch.tensor([0.0, 0.6, 0.0, 0.9]).expand(frames, 4)
    torch.testing.assert_close(travel, expected, atol=1e-5, rtol=0)


def test_turning_is_in_radians_a_second_across_the_seam_of_pi() -> None:
    yaw = np.linspace(3.0, 3.4, 9)
    rotations = np.zeros((9, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    rotations[:, 0] = np.stack([np.cos(yaw / 2), 0 * yaw, np.sin(yaw / 2), 0 * yaw], -1)
    turn = features(rotations, np.zeros((9, 3), np.float32))[:, -2]
    torch.testing.assert_close(turn, torch.full((9,), 0.05 * 30), atol=1e-4, rtol=0)
