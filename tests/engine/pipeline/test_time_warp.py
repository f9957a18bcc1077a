import numpy as np
import pytest
import torch

from echoavatar.engine.pipeline.time_warp import LARGEST_LAG, LARGEST_ROTATION, TimeWarp
from echoavatar.motion.motion_chunk import MotionBatch, MotionChunk, join_batches

JOINTS = 3


def turning(frames: int, degrees: float = 2.0) -> MotionChunk:
    """A body that walks 2 cm a frame along x while its first joint turns about y."""
    half = np.deg2rad(degrees) * np.arange(frames) / 2
    rotations = np.tile(np.float32([1, 0, 0, 0]), (frames, JOINTS, 1))
    rotations[:, 0, 0], rotations[:, 0, 2] = np.cos(half), np.sin(half)
    root = np.zeros((frames, 3), np.float32)
    root[:, 0] = 0.02 * np.arange(frames)
    return MotionChunk(rotations, root)


def played(motion: MotionChunk, brake: np.ndarray) -> MotionChunk:
    """The motion in chunks of eight frames."""
    time_warp = TimeWarp(JOINTS)
    state, everyone, shown = time_warp.init_state(1), torch.ones(1, dtype=torch.bool), []
    for at in range(0, len(brake), 8):
        made = MotionBatch(motion.rotations[None, at : at + 8], motion.root[None, at : at + 8])
        asked = torch.from_numpy(brake[None, at : at + 8].astype(np.float32))
        shown.append(time_warp.step(made, asked, state, everyone))
    [played_motion] = join_batches(shown).split(None)
    return played_motion


def frames_shown(motion: MotionChunk, degrees: float = 2.0) -> np.ndarray:
    """Which frame as made each frame shows, by the first joint's angle."""
    half = np.arctan2(motion.rotations[:, 0, 2], motion.rotations[:, 0, 0])
    return np.asarray(np.unwrap(2 * half) / np.deg2rad(degrees))


def test_with_nothing_to_brake_for_motion_passes_as_it_is() -> None:
    shown = played(turning(48), np.zeros(48))
    np.testing.assert_array_equal(shown.rotations, turning(48).rotations)
    np.testing.assert_array_equal(shown.root, turning(48).root)


def test_a_dip_slows_the_body_there_and_is_made_up_for() -> None:
    """The witness is the path: the angle shown tells which frame it is; the root must be at the same one."""
    at = np.arange(96)
    shown = played(turning(96), np.exp(-0.5 * ((at - 40) / 2.0) ** 2))
    which = frames_shown(shown)
    pace = np.diff(which)
    assert pace.min() < 0.4
    assert abs(int(pace.argmin()) + 0.5 - 40) <= 2.5
    assert (pace > 0).all()  # time never runs backwards
    assert 1.1 < pace.max() <= 1.6
    lag = at - which
    assert 1.5 < lag.max() <= LARGEST_LAG
    assert lag[:30] == pytest.approx(0, abs=1e-3)
    assert lag[-1] < 0.05
    np.testing.assert_allclose(shown.root[:, 0], 0.02 * which, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(shown.rotations, axis=-1), 1, atol=1e-6)


def test_the_lag_has_a_bound_and_a_session_that_begins_braking_shows_its_first_frame() -> None:
    shown = frames_shown(played(turning(64), np.ones(64)))
    assert shown[0] == 0
    assert np.arange(64)[40:] - shown[40:] == pytest.approx(LARGEST_LAG, abs=1e-3)


def test_catching_up_turns_no_joint_faster_than_the_bound() -> None:
    """At 36 degrees a frame (1,080 a second) there is little room above the speed as made."""
    at = np.arange(96)
    shown = frames_shown(played(turning(96, 36.0), np.exp(-0.5 * ((at - 30) / 2.0) ** 2)), 36.0)
    pace = np.diff(shown)
    assert pace.min() < 0.5
    assert np.deg2rad(36.0) * pace.max() <= LARGEST_ROTATION * 1.001
    assert np.deg2rad(36.0) * pace.max() > 0.99 * LARGEST_ROTATION
