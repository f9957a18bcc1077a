from dataclasses import replace

import numpy as np
import pytest
import torch
from lab.tests.models.fingers.moving import waving, without

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, matrix_from_quaternion
from echoavatar_lab.data.clip import mirror_quaternions
from echoavatar_lab.models.fingers.clips import (
    BODY_SIZE,
    FINGERS,
    angular_speeds,
    body_features,
    finger_clip,
    finger_rotations,
    hand_poses,
    on_our_rig,
)
from echoavatar_lab.models.fingers.train import fit_basis


def test_finger_rotations_inverts_hand_poses() -> None:
    fingers = matrix_from_axis_angle(np.random.default_rng(0).standard_normal((7, 30, 3)))
    np.testing.assert_allclose(finger_rotations(hand_poses(fingers)), fingers, atol=1e-6)


def test_a_mirrored_body_has_its_hands_swapped() -> None:
    turns = torch.from_numpy(waving(20).rotations)
    hands, mirrored = (
        hand_poses(matrix_from_quaternion(q.numpy())[:, list(FINGERS)])
        for q in (turns, mirror_quaternions(HUMANOID, turns))
    )
    np.testing.assert_allclose(mirrored, hands[:, ::-1], atol=1e-6)


def test_the_basis_keeps_the_variance_and_normalises_it() -> None:
    """Poses with three dimensions are recovered from three coordinates, but not from two."""
    hands = torch.randn(500, 3) * torch.tensor([1.0, 0.3, 0.1]) @ torch.randn(3, 90) + 1
    three, two = fit_basis(hands, 3), fit_basis(hands, 2)
    torch.testing.assert_close(three.decode(three.encode(hands)), hands, atol=1e-3, rtol=1e-3)
    assert (two.decode(two.encode(hands)) - hands).abs().max() > 0.1
    spread = three.encode(hands).std(0, correction=0)
    torch.testing.assert_close(spread, three.spread, atol=1e-2, rtol=1e-2)
    assert abs(float(spread.square().mean()) - 1) < 0.02


def body(frames: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """A body in motion that walks and turns."""
    random = np.random.default_rng(0)
    turns = matrix_from_axis_angle(0.5 * random.standard_normal((frames, HUMANOID.joints, 3)).cumsum(0) / frames)
    return turns, 0.02 * random.standard_normal((frames, 3)).cumsum(0) + HUMANOID.offsets[0]


def test_fingers_do_not_enter_and_neither_do_place_and_heading() -> None:
    turns, root = body()
    features = body_features(turns, root)
    assert features.shape == (20, BODY_SIZE)
    other = turns.copy()
    other[:, list(FINGERS)] = matrix_from_axis_angle(np.random.default_rng(1).standard_normal((20, 30, 3)))
    np.testing.assert_allclose(body_features(other, root), features, atol=1e-6)
    about = matrix_from_axis_angle(np.array([0.0, 2.0, 0.0]))
    turned = turns.copy()
    turned[:, 0] = about @ turns[:, 0]
    moved = root @ about.T + [3.0, 0.0, -2.0]
    np.testing.assert_allclose(body_features(turned, moved), features, atol=2e-5, rtol=1e-4)


def test_numbers_are_metres_and_metres_per_second() -> None:
    """T-pose walking at 1.2 m/s forward: left wrist 0.67 m to the left, hips 0.95 m high."""
    root = HUMANOID.offsets[0] + np.outer(np.arange(10), [0.0, 0.0, 0.04])
    features = body_features(np.tile(np.eye(3), (10, HUMANOID.joints, 1, 1)), root)
    assert features[5, 0] == pytest.approx(0.67)
    np.testing.assert_allclose(features[5, -3:], [1.2, 0.0, 0.95], atol=1e-4, rtol=0)
    assert np.abs(features[:, 3:6]).max() < 1e-4  # no speed relative to the hips


def test_one_frame_has_features() -> None:
    own = waving(1)
    assert np.isfinite(body_features(own.matrices(), own.root)).all()


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
    np.testing.assert_allclose(own.rotations, motion.rotations, atol=1e-6)


def test_a_rig_without_little_fingers_has_hands_all_the_same() -> None:
    motion = without(waving(20), "Little")
    assert finger_clip(replace(motion)).hands.shape == (20, 2, 90)


def test_speeds_are_degrees_per_second() -> None:
    turns = matrix_from_axis_angle(np.arange(4.0)[:, None, None] * np.array([[0.1, 0.0, 0.0]]))
    np.testing.assert_allclose(angular_speeds(turns, 30.0), [171.887], atol=1e-2, rtol=0)
    assert angular_speeds(turns[:1], 30.0).tolist() == [0.0]
