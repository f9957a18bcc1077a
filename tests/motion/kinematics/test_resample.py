import numpy as np
import pytest
import torch
from tests.motion.kinematics.samples import swaying

from echoavatar.motion.kinematics.resample import align_signs, resample
from echoavatar.motion.kinematics.rotations import angle_between


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
    torch.testing.assert_close(first, second, atol=1e-5, rtol=0)


def test_a_single_frame_stays():
    assert resample(swaying(1), 60).frames == 1


def test_signs_are_aligned_without_changing_a_rotation():
    """Frames 10 to 19 are negated: the same rotations, and interpolation would take the long way."""
    motion = swaying(30)
    flipped = motion.rotations.copy()
    flipped[10:20] *= -1
    assert np.array_equal(align_signs(flipped), motion.rotations)
