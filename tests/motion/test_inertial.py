import math

import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.motion.inertial import InertialBlend
from echoavatar.motion.kinematics.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle
from echoavatar.motion.motion_chunk import MotionChunk


def about_x(angle: np.ndarray, root: np.ndarray | None = None, face: float | None = None) -> MotionChunk:
    """Two joints: the first turns by `angle` (t,) about X, the second rests."""
    vectors = np.zeros((len(angle), 2, 3), np.float64)
    vectors[:, 0, 0] = angle
    turns = quaternion_from_axis_angle(vectors).astype(np.float32)
    root = np.zeros((len(angle), 3)) if root is None else root
    curves = None if face is None else np.full((len(angle), 52), face, np.float32)
    return MotionChunk(turns, root.astype(np.float32), curves)


def angle_of(chunk: MotionChunk) -> np.ndarray:
    return axis_angle_from_quaternion(chunk.rotations.astype(np.float64))[:, 0, 0]


def cut(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    blend = InertialBlend()
    blend.begin(about_x(old))
    return np.concatenate([old, angle_of(blend.step(about_x(new)))])


def test_new_motion_is_untouched_before_a_cut_and_after_the_blend() -> None:
    blend = InertialBlend()
    chunk = about_x(np.linspace(0, 1, 8))
    assert blend.step(chunk) is chunk
    blend.begin(about_x(np.ones(2)))
    blend.step(chunk)
    assert blend.step(chunk) is chunk


def test_motion_that_goes_on_as_it_was_is_not_changed() -> None:
    """Cutting a sine in two and joining the halves gives the sine, but for the curvature of one frame."""
    sine = 0.5 * np.sin(np.arange(40) * 2 * math.pi / 40)
    assert np.abs(cut(sine[:20], sine[20:]) - sine).max() < 0.013  # 0.5 (2 pi / 40)^2


def test_a_jump_becomes_a_smooth_path_in_a_quarter_of_a_second() -> None:
    """From rest at 1 rad to rest at 0 in 159 ms, a quarter of a second for half a turn: a quintic, worked out here."""
    path = cut(np.ones(4), np.zeros(12))
    share = np.minimum(np.arange(1, 13) / 30 / (0.5 / math.pi), 1)
    np.testing.assert_allclose(path[4:], 1 - 10 * share**3 + 15 * share**4 - 6 * share**5, atol=1e-6)


def test_speed_is_carried_over_and_dies_away() -> None:
    """A joint that turned at 3 rad/s into one at rest: it swings on, by less than 5 cm on an arm, and returns."""
    path = cut(np.arange(4) * 0.1 - 0.3, np.zeros(12))
    step = np.diff(path)
    assert step[3] == pytest.approx(0.1, abs=0.025)  # goes on at the old speed
    assert 0.02 < path.max() < 0.1
    np.testing.assert_allclose(path[-4:], 0, atol=1e-6)


@pytest.mark.parametrize("gap", [0.5, 1.5, 3.1])
def test_no_joint_turns_faster_than_800_degrees_a_second(gap: float) -> None:
    path = cut(np.full(4, gap), np.zeros(24))
    assert np.abs(np.diff(path)).max() * 30 <= math.radians(801)
    assert path[-1] == pytest.approx(0, abs=1e-6)


def test_a_small_gap_is_closed_in_150_ms() -> None:
    """A tenth of a radian: gone after five frames, still seen after three."""
    path = cut(np.full(4, 0.1), np.zeros(12))[4:]
    assert path[2] > 0.005
    assert np.abs(path[4:]).max() < 1e-6


@pytest.mark.parametrize(("speed", "least", "most"), [(400, 7, 12), (1_500, 11, 18)])
def test_a_joint_swings_on_the_further_the_faster_it_was(speed: float, least: float, most: float) -> None:
    """Degrees a second into degrees; a flick that no arm makes swings no further than one of 600 degrees a second."""
    path = np.degrees(cut(np.radians(speed) / 30 * np.arange(-3, 1), np.zeros(12)))
    assert least < path.max() < most
    assert np.abs(path[-4:]).max() < 1e-3


def test_a_body_is_not_thrown_across_the_floor() -> None:
    """A metre to the side: at two metres a second at most, and within one."""
    blend = InertialBlend()
    blend.begin(about_x(np.zeros(2), np.tile([1.0, 0.0, 0.0], (2, 1))))
    way = blend.step(about_x(np.zeros(32))).root[:, 0]
    assert 1.8 < np.abs(np.diff(way)).max() * 30 < 2.05
    assert way[-1] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("cuts", [[8, 8, 8], [2, 1, 5, 16], [24]])
def test_any_chunking_gives_the_whole(cuts: list[int]) -> None:
    new = 0.3 * np.sin(np.arange(24) / 3)
    whole = cut(np.array([1.0, 1.1]), new)[2:]
    blend, at, parts = InertialBlend(), 0, []
    blend.begin(about_x(np.array([1.0, 1.1])))
    for size in cuts:
        parts.append(angle_of(blend.step(about_x(new[at : at + size]))))
        at += size
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-6)


def test_root_and_face_follow() -> None:
    blend = InertialBlend()
    blend.begin(about_x(np.zeros(2), np.tile([0.1, 0.0, 0.0], (2, 1)), face=1.0))
    out = blend.step(about_x(np.zeros(10), face=0.0))
    assert out.face is not None
    assert out.root[0, 0] > 0.09
    assert np.diff(out.root[:, 0]).max() <= 0
    assert out.root[-1, 0] == pytest.approx(0, abs=1e-6)
    assert 0.5 < out.face[0].min() < 1
    assert not out.face[4:].any()


def test_a_second_cut_starts_from_what_was_shown() -> None:
    blend = InertialBlend()
    blend.begin(about_x(np.ones(2)))
    first = blend.step(about_x(np.zeros(3)))
    blend.begin(first)
    after = angle_of(blend.step(about_x(np.full(8, -1.0))))
    path = np.concatenate([angle_of(first), after])
    assert np.abs(np.diff(path, n=2)).max() < 0.35
    assert path[-1] == pytest.approx(-1, abs=0.02)


def test_one_frame_is_not_enough() -> None:
    blend = InertialBlend()
    with pytest.raises(MotionError, match="two frames"):
        blend.begin(about_x(np.zeros(1)))
    blend.begin(about_x(np.zeros(2)))
    with pytest.raises(MotionError, match="two frames"):
        blend.step(about_x(np.zeros(1)))
