from dataclasses import replace

import torch
from tests.models.fingers.moving import waving, without

from echoavatar.models.fingers.clips import angular_speeds, finger_clip, on_our_rig
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle


def test_hands_with_moving_fingers_are_found() -> None:
    assert finger_clip(waving()).is_moving.tolist() == [True, True]
    assert finger_clip(waving(still=("left",))).is_moving.tolist() == [False, True]


def test_a_short_clip_runs_there_and_back() -> None:
    clip = finger_clip(waving(5), at_least=12)
    assert clip.hands.shape[0] == clip.body.shape[0] == 12
    torch.testing.assert_close(clip.hands[:9], clip.hands[:9].flip(0))
    torch.testing.assert_close(clip.hands[8:], clip.hands[:4])
    assert len(finger_clip(waving(1), at_least=4).hands) == 4


def test_any_rate_is_resampled_to_thirty() -> None:
    motion = waving(61)
    fast = resample(motion, 60.0)
    own = on_our_rig(fast)
    assert (own.frames, own.fps) == (61, 30.0)
    torch.testing.assert_close(torch.from_numpy(own.rotations), torch.from_numpy(motion.rotations))


def test_a_rig_without_little_fingers_has_hands_all_the_same() -> None:
    motion = without(waving(20), "Little")
    assert finger_clip(replace(motion)).hands.shape == (20, 2, 90)


def test_speeds_are_degrees_per_second() -> None:
    turns = matrix_from_axis_angle(torch.arange(4.0)[:, None, None] * torch.tensor([[0.1, 0.0, 0.0]]))
    torch.testing.assert_close(angular_speeds(turns, 30.0), torch.tensor([171.887]), atol=1e-2, rtol=0)
    assert angular_speeds(turns[:1], 30.0).tolist() == [0.0]
