import pytest
import torch

from echoavatar.motion.kinematics import HUMANOID, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, matrix_from_quaternion
from echoavatar.motion.motion_chunk import join_batches
from echoavatar.motion.stages.post import Post

CHEST = HUMANOID.index("chest")


def nodding(frames: int = 16) -> torch.Tensor:
    turns = torch.zeros(1, frames, HUMANOID.joints, 3)
    turns[..., CHEST, 0] = torch.linspace(0, 0.3, frames)
    root = HUMANOID.offsets[0].expand(1, frames, 3)
    return to_features(HUMANOID, matrix_from_axis_angle(turns), root)


def shown(features: torch.Tensor) -> tuple[Post, torch.Tensor, torch.Tensor]:
    post = Post(HUMANOID, stages=("ground", "feet", "hands"))
    state, on = post.init_state(1), torch.ones(1, dtype=torch.bool)
    motion = join_batches([post.step(part, state, on) for part in features.split(8, 1)])
    turns = matrix_from_quaternion(torch.from_numpy(motion.rotations[0]))
    return post, turns, torch.from_numpy(motion.root[0])


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0])
def test_a_joint_that_is_lost_holds_and_comes_back(value: float, caplog: pytest.LogCaptureFixture) -> None:
    """Frames 4 to 6 of the chest are garbage: it stays as in frame 3, the rest of the body does not notice."""
    good, broken = nodding(), nodding()
    at = HUMANOID.feature_joints.index(CHEST) * 6 + 3  # behind the three numbers of travel
    broken[:, 4:7, at : at + 6] = value
    post, turns, root = shown(broken)
    _, wanted, _ = shown(good)
    torch.testing.assert_close(turns[4:7, CHEST], wanted[[3, 3, 3], CHEST], atol=1e-5, rtol=0)
    torch.testing.assert_close(turns[7:], wanted[7:], atol=1e-5, rtol=0)
    others = [joint for joint in range(HUMANOID.joints) if joint != CHEST]
    torch.testing.assert_close(turns[:, others], wanted[:, others], atol=1e-5, rtol=0)
    assert post.repaired == 3
    assert "3 rotations" in caplog.text
    assert torch.isfinite(root).all()


def test_a_stream_of_nothing_but_garbage_stands_at_rest() -> None:
    post, turns, root = shown(torch.full((1, 8, 315), float("nan")))
    torch.testing.assert_close(turns, torch.eye(3).expand_as(turns), atol=5e-3, rtol=0)  # knees settle
    assert (root[:, 1] - HUMANOID.offsets[0, 1]).abs().max() < 0.01
    assert post.repaired == 8 * 53


def test_rotations_of_any_length_are_no_problem() -> None:
    """Rows scaled by 5: the same rotations, nothing to repair."""
    features = nodding()
    scaled = features.clone()
    at = HUMANOID.feature_joints.index(CHEST) * 6 + 3
    scaled[..., at : at + 6] *= 5
    post, turns, _ = shown(scaled)
    torch.testing.assert_close(turns, shown(features)[1], atol=1e-5, rtol=0)
    assert post.repaired == 0
