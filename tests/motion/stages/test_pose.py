import numpy as np
import pytest
from tests.motion.stages.poses import cut

from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig, to_features
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_axis_angle, matrix_from_quaternion
from echoavatar.motion.motion_chunk import join_batches
from echoavatar.motion.stages.pose import Pose, Unpacking
from echoavatar.motion.stages.post import Post


def test_a_pose_knows_how_many_frames_it_has() -> None:
    assert Pose(np.zeros((2, 5, 3, 4), np.float32), np.zeros((2, 5, 3), np.float32), 30.0).frames == 5


def bodies(rows: int = 3, frames: int = 8) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    turns = generator.standard_normal((rows, frames, HUMANOID.joints, 3)).astype(np.float32)
    return matrix_from_axis_angle(turns), generator.standard_normal((rows, frames, 3)).astype(np.float32)


@pytest.mark.parametrize("frames", [8, 3])
def test_features_become_the_rotations_they_were_made_of(frames: int) -> None:
    """Outside witness: `to_features`, there and back."""
    rotations, root = bodies(frames=frames)
    features = to_features(HUMANOID, rotations, root)
    pose, is_good = Unpacking(HUMANOID).pose_of(features, 30.0)
    shown, travel = pose.rotations, pose.root
    assert is_good
    assert shown.shape == (3, frames, HUMANOID.joints, 4)
    assert angle_between(matrix_from_quaternion(shown), rotations).max() < 2e-3
    decoded = features[..., travel_slice(HUMANOID)]
    np.testing.assert_array_equal(travel, decoded[..., [0, 2, 1]])  # across, height, along


def test_joints_without_features_rest() -> None:
    parts = {"lower": HUMANOID.config.parts["lower"]}
    rig = Skeleton(HUMANOID.config.model_copy(update={"parts": parts}))
    rotations, root = bodies()
    pose, _ = Unpacking(rig).pose_of(to_features(rig, rotations, root), 30.0)
    shown = pose.rotations
    others = [joint for joint in range(rig.joints) if joint not in parts["lower"]]
    assert (shown[:, :, others] == [1, 0, 0, 0]).all()
    lower = list(parts["lower"])
    turned = matrix_from_quaternion(shown[:, :, lower])
    assert angle_between(turned, rotations[:, :, lower]).max() < 2e-3


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("channel", [0, 100, 314, "height"])
def test_garbage_anywhere_is_noticed(value: float, channel: int | str) -> None:
    features = to_features(HUMANOID, *bodies())
    at = travel_slice(HUMANOID).stop - 1 if channel == "height" else int(channel)
    features[1, 5, at] = value
    _, is_good = Unpacking(HUMANOID).pose_of(features, 30.0)
    assert not is_good


def chain(joints: int, parts: dict[str, tuple[int, ...]]) -> Skeleton:
    """Bones of 10 cm, one above the other."""
    offsets = ((0.0, 0.1, 0.0),) * joints
    names, parents = tuple(f"bone{joint}" for joint in range(joints)), tuple(range(-1, joints - 1))
    return Skeleton(SkeletonConfig(names=names, parents=parents, offsets=offsets, parts=parts))


@pytest.mark.parametrize("joints", [1, 2, 5])
@pytest.mark.parametrize("frames", [8, 5])
def test_no_joint_of_a_small_rig_is_lost(joints: int, frames: int) -> None:
    rig = chain(joints, {"lower": tuple(range(joints))})
    turns = np.random.default_rng(joints).standard_normal((2, frames, joints, 3))
    rotations = matrix_from_axis_angle(turns)
    pose, is_good = Unpacking(rig).pose_of(to_features(rig, rotations, np.zeros((2, frames, 3), np.float32)), 30.0)
    shown = pose.rotations
    assert is_good
    assert angle_between(matrix_from_quaternion(shown), rotations).max() < 2e-3


CHEST = HUMANOID.index("chest")


def nodding(frames: int = 16) -> np.ndarray:
    turns = np.zeros((1, frames, HUMANOID.joints, 3), np.float32)
    turns[..., CHEST, 0] = np.linspace(0, 0.3, frames)
    root = np.broadcast_to(HUMANOID.offsets[0], (1, frames, 3))
    return to_features(HUMANOID, matrix_from_axis_angle(turns), root)


def shown(features: np.ndarray) -> tuple[Post, np.ndarray, np.ndarray]:
    post = Post(HUMANOID, stages=("ground", "feet", "hands"))
    state, on = post.init_state(1), np.ones(1, np.bool_)
    motion = join_batches([post.step(part, state, on) for part in cut(features)])
    turns = matrix_from_quaternion(motion.rotations[0])
    return post, turns, motion.root[0]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0])
def test_a_joint_that_is_lost_holds_and_comes_back(value: float, caplog: pytest.LogCaptureFixture) -> None:
    """Frames 4 to 6 of the chest are garbage: it stays as in frame 3, the rest of the body does not notice."""
    good, broken = nodding(), nodding()
    at = HUMANOID.feature_joints.index(CHEST) * 6 + 3  # behind the three numbers of travel
    broken[:, 4:7, at : at + 6] = value
    post, turns, root = shown(broken)
    _, wanted, _ = shown(good)
    np.testing.assert_allclose(turns[4:7, CHEST], wanted[[3, 3, 3], CHEST], atol=1e-5, rtol=0)
    np.testing.assert_allclose(turns[7:], wanted[7:], atol=1e-5, rtol=0)
    others = [joint for joint in range(HUMANOID.joints) if joint != CHEST]
    np.testing.assert_allclose(turns[:, others], wanted[:, others], atol=1e-5, rtol=0)
    assert post.repaired == 3
    assert "3 rotations" in caplog.text
    assert np.isfinite(root).all()


def test_a_stream_of_nothing_but_garbage_stands_at_rest() -> None:
    post, turns, root = shown(np.full((1, 8, 315), float("nan"), dtype=np.float32))
    np.testing.assert_allclose(
        turns, np.broadcast_to(np.eye(3, dtype=np.float32), turns.shape), atol=5e-3, rtol=0
    )  # knees settle
    assert np.abs(root[:, 1] - HUMANOID.offsets[0, 1]).max() < 0.01
    assert post.repaired == 8 * 53


def test_rotations_of_any_length_are_no_problem() -> None:
    """Rows scaled by 5: the same rotations, nothing to repair."""
    features = nodding()
    scaled = features.copy()
    at = HUMANOID.feature_joints.index(CHEST) * 6 + 3
    scaled[..., at : at + 6] *= 5
    post, turns, _ = shown(scaled)
    np.testing.assert_allclose(turns, shown(features)[1], atol=1e-5, rtol=0)
    assert post.repaired == 0
