import numpy as np
import torch
from tests.motion.kinematics.samples import swaying

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.evaluation.metrics.motion_features import TRAVEL, feature_count, motion_features
from echoavatar_lab.tables.baselines import facing


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
