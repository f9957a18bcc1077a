import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig, forward_kinematics
from echoavatar.motion.kinematics.motion import align_signs, resample
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_quaternion


def naive(skeleton, rotations, root):
    """Joint after joint, as the definition says."""
    turns, places = [rotations[0]], [root]
    for joint in range(1, skeleton.joints):
        parent = skeleton.parents[joint]
        places.append(places[parent] + turns[parent] @ skeleton.offsets[joint])
        turns.append(turns[parent] @ rotations[joint])
    return np.stack(turns), np.stack(places)


def random_pose(*shape, seed=0):
    generator = np.random.default_rng(seed)
    rotations = matrix_from_quaternion(generator.standard_normal((*shape, 52, 4)))
    return rotations, generator.standard_normal((*shape, 3))


def test_levels_give_what_the_definition_gives():
    rotations, root = random_pose(2, 3)
    pose = forward_kinematics(HUMANOID, rotations, root)
    for row in range(2):
        for t in range(3):
            turns, places = naive(HUMANOID, rotations[row, t], root[row, t])
            np.testing.assert_allclose(pose.rotations[row, t], turns, atol=1e-5)
            np.testing.assert_allclose(pose.positions[row, t], places, atol=1e-5)


def test_any_order_of_joints_will_do():
    """Two branches interleaved: 0-1-3-4 and 0-2."""
    offsets = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.5, 0.0, 0.0))
    skeleton = Skeleton(SkeletonConfig(names=tuple("abcde"), parents=(-1, 0, 0, 1, 3), offsets=offsets))
    generator = np.random.default_rng(1)
    rotations = matrix_from_quaternion(generator.standard_normal((5, 4)))
    root = np.array([1.0, 2.0, 3.0])
    pose = forward_kinematics(skeleton, rotations, root)
    turns, places = naive(skeleton, rotations, root)
    np.testing.assert_allclose(pose.positions, places, atol=1e-5)
    np.testing.assert_allclose(pose.rotations, turns, atol=1e-5)


def test_rest_pose_is_the_rest_pose():
    rotations = np.broadcast_to(np.eye(3, dtype=np.float32), (52, 3, 3))
    pose = forward_kinematics(HUMANOID, rotations, HUMANOID.offsets[0])
    np.testing.assert_allclose(pose.positions, HUMANOID.rest_positions, atol=1e-5)


def test_a_piece_keeps_its_frames():
    motion = swaying(20)
    piece = motion.cut(5, 9)
    assert piece.frames == 4
    assert piece.seconds == pytest.approx(4 / 30)
    assert np.array_equal(piece.root, motion.root[5:9])


def test_pose_has_the_root_where_it_is():
    motion = swaying(3)
    np.testing.assert_allclose(motion.pose().positions[:, 0], motion.root)


@pytest.mark.parametrize(
    ("frames", "joints", "fill", "fps", "complaint"),
    [
        (0, 52, 0.0, 30, "no frames"),
        (2, 51, 0.0, 30, "do not fit"),
        (2, 52, np.nan, 30, "not finite"),
        (2, 52, 0.0, 0, "not a frame rate"),
    ],
)
def test_what_is_no_motion_is_refused(frames, joints, fill, fps, complaint):
    rotations = np.full((frames, joints, 4), fill, np.float32)
    with pytest.raises(MotionError, match=complaint):
        Motion(HUMANOID, rotations, np.zeros((frames, 3), np.float32), fps)


@pytest.mark.parametrize(("start", "end"), [(30, 60), (60, 30), (30, 120), (25, 30), (24, 60), (30, 29.97)])
def test_shared_instants_are_exact(start, end):
    motion = swaying(61, fps=start)
    other = resample(motion, end)
    times, theirs = np.arange(motion.frames) / start, np.arange(other.frames) / end
    pairs = [(i, j) for j, t in enumerate(theirs) for i in [round(t * start)] if abs(times[i] - t) < 1e-9]
    assert pairs
    for i, j in pairs:
        assert np.array_equal(other.rotations[j], motion.rotations[i])
        assert np.array_equal(other.root[j], motion.root[i])


def test_length_in_seconds_is_kept():
    motion = swaying(91)
    for fps in (24, 25, 29.97, 50, 59.94, 60, 120):
        other = resample(motion, fps)
        assert 0 <= (motion.frames - 1) / 30 - (other.frames - 1) / fps < 1 / fps


def test_there_and_back_is_close():
    motion = swaying(60)
    back = resample(resample(motion, 120), 30)
    assert float(angle_between(back.matrices(), motion.matrices()).max()) < 1e-6
    np.testing.assert_allclose(back.root, motion.root, atol=1e-7)


def test_a_parabola_is_followed():
    motion = swaying(10)
    frame = np.arange(10, dtype=np.float32)
    curved = type(motion)(motion.skeleton, motion.rotations, np.stack([frame, frame**2, frame], 1), 30)
    half = np.arange(19) / 2
    np.testing.assert_allclose(resample(curved, 60).root[2:-2, 1], (half**2)[2:-2], atol=1e-4)


def test_turns_are_even_between_frames():
    motion = swaying(30)
    double = resample(motion, 60).matrices()
    first, second = angle_between(double[0:-1:2], double[1::2]), angle_between(double[1::2], double[2::2])
    np.testing.assert_allclose(first, second, atol=1e-5, rtol=0)


def test_a_single_frame_stays():
    assert resample(swaying(1), 60).frames == 1


def test_signs_are_aligned_without_changing_a_rotation():
    """Frames 10 to 19 are negated: the same rotations, and interpolation would take the long way."""
    motion = swaying(30)
    flipped = motion.rotations.copy()
    flipped[10:20] *= -1
    assert np.array_equal(align_signs(flipped), motion.rotations)


def test_frames_so_slow_that_a_short_file_lasts_for_years_are_refused():
    for fps in (0.0, 1e-5, float("nan")):
        with pytest.raises(MotionError, match="is not a frame rate"):
            Motion(HUMANOID, np.tile(np.float32([1, 0, 0, 0]), (2, 52, 1)), np.zeros((2, 3), np.float32), fps)
    slow = Motion(HUMANOID, np.tile(np.float32([1, 0, 0, 0]), (9_000, 52, 1)), np.zeros((9_000, 3), np.float32), 0.1)
    with pytest.raises(MotionError, match="too many frames"):
        resample(slow, 30.0)


@pytest.mark.parametrize("fps", [0.0, -30.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused_before_anything_is_computed(fps: float) -> None:
    with pytest.raises(MotionError, match="is not a frame rate"):
        resample(Motion.at_rest(HUMANOID), fps)
