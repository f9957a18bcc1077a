import torch
from tests.models.fingers.moving import waving

from echoavatar.models.fingers.body_features import BODY_SIZE, body_features, mirror_body
from echoavatar.models.fingers.hand_poses import FINGERS
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar_lab.data.clip import mirror_positions, mirror_rotations


def body(frames: int = 20) -> tuple[torch.Tensor, torch.Tensor]:
    """A body in motion that walks and turns."""
    torch.manual_seed(0)
    turns = matrix_from_axis_angle(0.5 * torch.randn(frames, HUMANOID.joints, 3).cumsum(0) / frames)
    return turns, 0.02 * torch.randn(frames, 3).cumsum(0) + HUMANOID.offsets[0]


def test_fingers_do_not_enter_and_neither_do_place_and_heading() -> None:
    turns, root = body()
    features = body_features(turns, root)
    assert features.shape == (20, BODY_SIZE)
    other = turns.clone()
    other[:, list(FINGERS)] = matrix_from_axis_angle(torch.randn(20, 30, 3))
    torch.testing.assert_close(body_features(other, root), features)
    about = matrix_from_axis_angle(torch.tensor([0.0, 2.0, 0.0]))
    turned = turns.clone()
    turned[:, 0] = about @ turns[:, 0]
    moved = (about @ root[..., None]).squeeze(-1) + torch.tensor([3.0, 0.0, -2.0])
    torch.testing.assert_close(body_features(turned, moved), features, atol=2e-5, rtol=1e-4)


def test_the_mirrored_features_are_those_of_the_mirrored_body() -> None:
    turns, root = body()
    mirrored = body_features(mirror_rotations(HUMANOID, turns), mirror_positions(root))
    torch.testing.assert_close(mirror_body(body_features(turns, root)), mirrored, atol=1e-5, rtol=1e-4)


def test_numbers_are_metres_and_metres_per_second() -> None:
    """T-pose walking at 1.2 m/s forward: left wrist 0.67 m to the left, hips 0.95 m high."""
    frames = torch.arange(10.0)
    root = HUMANOID.offsets[0] + frames[:, None] * torch.tensor([0.0, 0.0, 0.04])
    features = body_features(torch.eye(3).expand(10, HUMANOID.joints, 3, 3), root)
    torch.testing.assert_close(features[5, 0], torch.tensor(0.67))
    torch.testing.assert_close(features[5, -3:], torch.tensor([1.2, 0.0, 0.95]), atol=1e-4, rtol=0)
    assert features[:, 3:6].abs().max() < 1e-4  # no speed relative to the hips


def test_one_frame_has_features() -> None:
    own = waving(1)
    assert body_features(own.matrices(), torch.from_numpy(own.root)).isfinite().all()
