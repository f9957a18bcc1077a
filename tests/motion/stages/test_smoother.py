"""A turn that is too fast takes the frames it needs; others are not touched."""

import math

import numpy as np
import pytest
from tests.motion.stages.poses import everyone, from_quaternions, in_pieces, quaternions_of, root_of

from echoavatar.motion.kinematics.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle, unit
from echoavatar.motion.stages.pose import Pose
from echoavatar.motion.stages.smoother import BEND, DELAY, LATE, STIFFNESS, Smoother, SmootherState, SpeedLimit


def about_x(angle: np.ndarray) -> np.ndarray:
    """(1, t, 2, 4): the first joint turns by `angle` (t,) about X, the second rests."""
    turns = np.zeros((1, len(angle), 2, 3), np.float32)
    turns[0, :, 0, 0] = angle
    return quaternion_from_axis_angle(turns)


def step(
    smoother: Smoother, rotations: np.ndarray, state: SmootherState, active: np.ndarray | None = None
) -> np.ndarray:
    on = everyone(len(rotations)) if active is None else active

    def chunk(part: np.ndarray) -> np.ndarray:
        pose = from_quaternions(part, np.zeros((*part.shape[:2], 3), np.float32))
        smoother.step(pose, state, on)
        return quaternions_of(pose)

    return in_pieces(chunk, rotations, sizes=[4] * (rotations.shape[1] // 4))


def angle_of(rotations: np.ndarray) -> np.ndarray:
    return axis_angle_from_quaternion(rotations)[0, :, 0, 0]


def shown(angle: np.ndarray, **options: float) -> np.ndarray:
    """The path of the default bundle's chunks of 4 frames, each frame at the time of the one it was made of."""
    smoother, late = Smoother(2, **options), np.append(angle, np.full(4, angle[-1]))
    return angle_of(step(smoother, about_x(late), smoother.init_state(1)))[DELAY : len(angle) + DELAY]


def test_steps_between_latents_become_a_smooth_path() -> None:
    """A rotation that steps by chance every 4 frames, as noisy codes decode: the jerk falls by more than 5."""
    rng = np.random.default_rng(0)
    steps = np.repeat(0.05 * rng.standard_normal(40), 4)
    path = shown(steps)
    assert np.abs(np.diff(path, n=3)).mean() < np.abs(np.diff(steps, n=3)).mean() / 5
    assert np.abs(path - steps).mean() < 0.05


@pytest.mark.parametrize("frames", [8, 5, 4, 3])
def test_a_chunk_is_the_minimum_that_the_formula_asks_for(frames: int) -> None:
    """Outside witness: least squares in double precision, every chunk on top of the last three frames shown.

    The frame before the chunk was not shown yet; the chunk's last one waits for the next.
    """
    rng = np.random.default_rng(1)
    decoded = unit(np.array([1.0, 0.3, 0.2, 0.1]) + 0.03 * rng.standard_normal((24, 4)))
    travel = rng.standard_normal((24, 3))
    smoother = Smoother(1)
    state, path, way = (smoother.init_state(1), [decoded[0].astype(np.float64)] * 3, [travel[0].astype(np.float64)] * 3)
    waiting = decoded[:1], travel[:1]
    for turns, steps in zip(*(np.split(part, range(frames, 24, frames)) for part in (decoded, travel)), strict=True):
        found = least_squares(np.concatenate([waiting[0], turns]).astype(np.float64), np.array(path[-3:]))
        path.extend(found / np.linalg.norm(found, axis=1, keepdims=True))
        way.extend(least_squares(np.concatenate([waiting[1], steps]).astype(np.float64), np.array(way[-3:])))
        waiting = turns[-1:], steps[-1:]
        pose = from_quaternions(turns[None, :, None], steps[None])
        smoother.step(pose, state, everyone(1))
        np.testing.assert_allclose(quaternions_of(pose)[0, :, 0], path[-len(turns) :], atol=1e-5)
        np.testing.assert_allclose(root_of(pose)[0], way[-len(turns) :], atol=2e-5)


def least_squares(chunk: np.ndarray, past: np.ndarray) -> np.ndarray:
    """All but the last frame of the formula's minimum: an overdetermined system of distances and third differences."""
    t = len(chunk)
    third = np.diff(np.eye(3 + t), n=3, axis=0)
    third *= np.sqrt([STIFFNESS * (BEND if k % 4 == 1 else 1) for k in range(t)])[:, None]
    near = np.array([((k + 1) / t) ** (LATE / 2) for k in range(t)])[:, None]
    left = np.concatenate([near * np.eye(t), third[:, 3:]])
    right = np.concatenate([near * chunk, -third[:, :3] @ past])
    return np.asarray(np.linalg.lstsq(left, right, rcond=None)[0])[:-1]


def test_a_quick_stroke_keeps_its_time_and_size() -> None:
    """Sweeps of 1.2 rad in 0.4 s, as arms make them: a tenth of the way off at most."""
    time = np.arange(64) / 30
    stroke = 1.2 * np.sin(2 * math.pi * time / 0.8)
    assert np.abs((shown(stroke) - stroke)[8:]).max() < 0.12


def minimum_jerk(lead: int) -> np.ndarray:
    """A stroke of 1 rad in 0.4 s after `lead` frames at rest, as hands make them."""
    share = np.clip((np.arange(64) - lead) / 12, 0, 1)
    return share**3 * (10 - 15 * share + 6 * share * share)


def test_strokes_keep_their_course_and_trembling_does_not() -> None:
    """Strokes that begin anywhere in a chunk stay within 1.3 degrees; of the jerk of trembling a ninth is left."""
    strokes = [minimum_jerk(20 + place) for place in range(8)]
    assert max(np.abs(shown(stroke) - stroke).max() for stroke in strokes) < math.radians(1.3)
    rng = np.random.default_rng(0)
    tremble = np.repeat(0.05 * rng.standard_normal(400), 4)
    jerk = np.abs(np.diff(shown(tremble), n=3))
    assert jerk.mean() < 0.11 * np.abs(np.diff(tremble, n=3)).mean()


def test_a_step_is_felt_where_a_latent_begins_and_spread_over_all_of_it() -> None:
    """The jerk of its four frames differs by four to seven times: neither a corner nor a dead hand."""
    rng = np.random.default_rng(0)
    jerk = np.abs(np.diff(shown(np.repeat(0.05 * rng.standard_normal(400), 4)), n=3))
    each = [jerk[place::4].mean() for place in range(4)]
    assert 4 < max(each) / min(each) < 7


def test_no_stiffness_shows_what_was_decoded() -> None:
    rng = np.random.default_rng(0)
    angle = 0.5 * rng.random(32)
    np.testing.assert_allclose(shown(angle, stiffness=0.0), angle, atol=1e-5, rtol=0)


def test_a_jump_at_a_chunk_border_is_bridged() -> None:
    """Half a radian between two frames becomes a path whose acceleration is a fraction of the jump's."""
    jump = np.concatenate([np.zeros(16, np.float32), np.full(24, 0.5)])
    path = shown(jump)
    assert np.abs(np.diff(path, n=2)).max() < 0.4 * np.abs(np.diff(jump, n=2)).max()
    assert path[-1] == pytest.approx(0.5, abs=0.01)


def test_no_joint_turns_faster_than_the_bound() -> None:
    """A jump of 3 rad is spread: 1,000 degrees a second are 0.582 rad a frame."""
    jump = np.concatenate([np.zeros(8, np.float32), np.full(24, 3.0)])
    path = shown(jump)
    assert np.abs(path[1:] - path[:-1]).max() <= math.radians(1000) / 30 + 1e-4
    assert path[-1] == pytest.approx(3.0, abs=0.05)


def test_the_sign_of_a_quaternion_does_not_matter() -> None:
    smooth = about_x(np.linspace(0, 1, 16))
    flipped = smooth.copy()
    flipped[:, ::2] *= -1
    smoother = Smoother(2)
    one, other = (angle_of(step(smoother, x, smoother.init_state(1))) for x in (smooth, flipped))
    np.testing.assert_allclose(one, other, atol=1e-5)


def test_idle_rows_stay_untouched() -> None:
    smoother = Smoother(2)
    state = smoother.init_state(2)
    step(smoother, np.concatenate([about_x(np.ones(8))] * 2), state, np.array([True, False]))
    assert all(not tensor[1].any() for tensor in state.arrays())


FPS = 30.0
MOST = 1000 / FPS  # degrees


def pose(degrees) -> Pose:
    """Two joints: one turned about X by these angles, frame by frame, one at rest."""
    half = np.radians(np.asarray(degrees, float)) / 2
    rotations = np.zeros((1, len(half), 2, 4), np.float32)
    rotations[..., 0] = 1
    rotations[0, :, 0, 0], rotations[0, :, 0, 1] = np.cos(half), np.sin(half)
    return Pose(rotations, np.zeros((1, len(half), 3), np.float32), FPS)


def angles(shown: Pose) -> np.ndarray:
    return np.degrees(2 * np.arctan2(shown.rotations[0, :, 0, 1], shown.rotations[0, :, 0, 0]))


def run(pieces, active=True):
    limit = SpeedLimit(2)
    state, found = limit.init_state(1), []
    for piece in pieces:
        shown = pose(piece)
        limit.step(shown, state, np.array([active]))
        found.append(angles(shown))
    return np.concatenate(found)


def test_a_flick_takes_as_long_as_it_may_and_arrives():
    flick = [0.0, 0.0, 80.0, 80.0, 80.0, 80.0, 80.0, 80.0]
    shown = run([flick])
    np.testing.assert_allclose(shown, [0, 0, MOST, 2 * MOST, 80, 80, 80, 80], atol=1e-2)


def test_what_is_slow_enough_stays_as_it_is():
    slow = np.linspace(0, 7 * 0.9 * MOST, 8)
    given = pose(slow)
    before = given.rotations.copy()
    SpeedLimit(2).step(given, SpeedLimit(2).init_state(1), np.array([True]))
    np.testing.assert_array_equal(given.rotations, before)


def test_chunks_are_as_one_and_a_new_session_begins_anywhere():
    path = [50.0, 50.0, 150.0, 150.0, 150.0, 20.0, 20.0, 20.0]
    np.testing.assert_allclose(run([path[:3], path[3:]]), run([path]), atol=1e-3)
    assert run([path])[0] == run([path], active=False)[0]
    np.testing.assert_allclose(run([path], active=False), path, atol=1e-3)
