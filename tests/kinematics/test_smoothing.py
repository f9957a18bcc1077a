import numpy as np
import torch
from tests.kinematics.samples import swaying

from echoavatar.kinematics import Motion
from echoavatar.kinematics.rotations import angle_between
from echoavatar.kinematics.smoothing import align_signs, smooth_motion


def test_noise_goes_and_motion_stays():
    clean = swaying(120)
    generator = np.random.default_rng(0)
    noisy_turns = clean.rotations + generator.normal(0, 0.01, clean.rotations.shape)
    noisy_turns = (noisy_turns / np.linalg.norm(noisy_turns, axis=-1, keepdims=True)).astype(np.float32)
    noisy = Motion(clean.skeleton, noisy_turns, clean.root, 30)
    calm = smooth_motion(noisy, 0.25)
    before = angle_between(noisy.matrices(), clean.matrices()).mean()
    after = angle_between(calm.matrices(), clean.matrices()).mean()
    assert after < before / 1.6


def test_signs_do_not_matter():
    motion = swaying(30)
    flipped = motion.rotations.copy()
    flipped[10:20] *= -1
    assert np.array_equal(align_signs(flipped), align_signs(motion.rotations))
    other = smooth_motion(Motion(motion.skeleton, flipped, motion.root, 30), 0.2)
    torch.testing.assert_close(other.matrices(), smooth_motion(motion, 0.2).matrices())


def test_a_window_under_two_frames_changes_nothing():
    motion = swaying(5)
    assert smooth_motion(motion, 0.01) is motion
