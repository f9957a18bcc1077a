"""Eye contact: where the head points and the eyes look, in degrees; and that it comes and goes without a jerk."""

import numpy as np
import pytest
from tests.motion.viewer import off_viewer

from echoavatar.motion.action_overlay import Overlay
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.gaze import FALL_S, FARTHEST, LOOK, RISE_S, Gaze, turn_eyes, turn_head
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.motion_chunk import MotionChunk

ALL = np.ones(8, np.float32)


def facing(yaw: float, pitch: float = 0.0, joint: str = "chest") -> MotionChunk:
    """A body that is turned there by one joint, degrees: to its left, and down."""
    rotations = np.zeros((8, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    half_yaw, half_pitch = np.radians([yaw, pitch]) / 2
    left = np.array([np.cos(half_yaw), 0, np.sin(half_yaw), 0])
    down = np.array([np.cos(half_pitch), np.sin(half_pitch), 0, 0])
    w, x, y, z = left[0] * down[0], left[0] * down[1], left[2] * down[0], -left[2] * down[1]
    rotations[:, HUMANOID.index(joint)] = [w, x, y, z]
    return MotionChunk(rotations, np.zeros((8, 3), np.float32), np.zeros((8, 52), np.float32))


def degrees_off(motion: MotionChunk) -> float:
    return float(np.degrees(off_viewer(motion)).max())


def look(motion: MotionChunk, way: str) -> float:
    assert motion.face is not None
    return float(np.degrees(motion.face[-1, ARKIT_NAMES.index(f"eyeLook{way}")] * LOOK))


@pytest.mark.parametrize(("yaw", "pitch"), [(30, 0), (-30, 0), (0, 25), (0, -20), (25, 15)])
def test_head_and_eyes_meet_the_viewer_between_them(yaw: float, pitch: float) -> None:
    """Of 30 degrees the head turns back 24, the eyes the other 6."""
    before = facing(yaw, pitch)
    head = turn_head(before, ALL, HUMANOID)
    assert degrees_off(head) == pytest.approx(0.2 * degrees_off(before), abs=0.1)
    eyes = turn_eyes(head, ALL, HUMANOID)
    sideways = look(eyes, "InLeft") - look(eyes, "OutLeft")  # to its right
    assert sideways == pytest.approx(look(eyes, "OutRight") - look(eyes, "InRight"))
    upwards = look(eyes, "UpLeft") - look(eyes, "DownLeft")
    assert np.hypot(sideways, upwards) == pytest.approx(degrees_off(head), abs=0.5)
    assert np.sign(sideways) == np.sign(yaw) or yaw == 0
    assert np.sign(upwards) == np.sign(pitch) or pitch == 0
    np.testing.assert_allclose(np.linalg.norm(eyes.rotations, axis=-1), 1, atol=1e-5)


def test_only_neck_head_and_eyes_move() -> None:
    before = facing(40)
    after = turn_eyes(turn_head(before, ALL, HUMANOID), ALL, HUMANOID)
    moved = np.abs(after.rotations - before.rotations).max((0, 2)) > 1e-6
    assert {name for name, has in zip(HUMANOID.names, moved, strict=True) if has} == {"neck", "head"}
    assert after.face is not None
    shapes = {ARKIT_NAMES[at] for at in np.flatnonzero(after.face.any(0))}
    assert shapes == {"eyeLookInLeft", "eyeLookOutRight"}


def test_a_neck_turns_so_far_and_nobody_looks_behind() -> None:
    """At 75 degrees the head turns by its most, at 180 not at all, and nothing jumps on the way there."""
    sides = [degrees_off(facing(yaw)) - degrees_off(turn_head(facing(yaw), ALL, HUMANOID)) for yaw in range(181)]
    assert max(sides) == pytest.approx(np.degrees(FARTHEST), abs=0.5)
    assert sides[75] == pytest.approx(np.degrees(FARTHEST), abs=0.5)
    assert sides[160] == pytest.approx(0, abs=0.01)
    assert np.abs(np.diff(sides)).max() < 2.5
    behind = turn_eyes(facing(179), ALL, HUMANOID)
    assert behind.face is not None
    assert behind.face.max() == pytest.approx(0, abs=1e-6)


def test_it_comes_and_goes_smoothly_and_a_chunk_made_again_is_the_same() -> None:
    gaze = Gaze()
    shares = [gaze.shares(chunk, is_wanted=2 <= chunk < 6) for chunk in range(12)]
    path = np.concatenate(shares)
    assert path[:16].max() == 0
    assert path[16 + round(RISE_S * 30) :][: 48 - 16 - 15].min() == 1
    assert path[48 + round(FALL_S * 30) :].max() == 0
    assert np.abs(np.diff(path)).max() < 2.0 / (RISE_S * 30)
    assert np.array_equal(gaze.shares(3, is_wanted=True), shares[3])
    assert np.array_equal(gaze.shares(7, is_wanted=False), shares[7])


def test_a_nod_lowers_the_head_and_not_the_eyes() -> None:
    """15 degrees down on top: the head points there, the eyes look up by as much."""
    gaze = Gaze()
    nod = Overlay(("head",), np.tile(np.float32([np.radians(15), 0, 0]), (8, 1, 1)))
    for chunk in range(3):
        seen = gaze.apply(chunk, facing(0), HUMANOID, overlay=nod, is_wanted=True)
    assert degrees_off(seen) == pytest.approx(15, abs=0.1)
    assert look(seen, "UpLeft") == pytest.approx(15, abs=0.5)


def test_unwanted_it_changes_nothing() -> None:
    before = facing(20)
    assert Gaze().apply(0, before, HUMANOID, is_wanted=False) is before
