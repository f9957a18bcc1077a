import math

import numpy as np
import pytest
from pydantic import ValidationError

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, quaternion_from_matrix
from echoavatar.motion.stages.modes import IdleLegs, MotionOptions
from echoavatar.motion.stages.pose import Pose
from echoavatar.motion.stages.post import Post
from echoavatar_lab.data.faults import skate
from echoavatar_lab.evaluation.codes import replayed

BALLS = list(HUMANOID.config.feet)[1::2]
STANDING = HUMANOID.rest_positions[BALLS, 1]


def walking(seconds: float = 8.0, pace: float = 0.35) -> Motion:
    """Steps to the left and further to the left: each foot lifts in turn, the pelvis goes on over the other one."""
    frames = round(seconds * 30)
    time = np.arange(frames) / 30
    turns = np.zeros((frames, HUMANOID.joints, 3), np.float32)
    for side, shift in (("left", 0.0), ("right", 0.5)):
        phase = (time + shift) % 1.0
        lift = np.where(phase < 0.4, np.sin(np.pi * phase / 0.4) ** 2, 0.0)
        # stance: the foot goes from ahead to behind of the pelvis; swing: back
        swing = np.where(phase < 0.4, -np.cos(np.pi * phase / 0.4), 1 - 2 * (phase - 0.4) / 0.6)
        across = np.arcsin(swing * pace * 0.3 / 0.85).astype(np.float32)
        knee = (0.25 + 0.7 * lift).astype(np.float32)
        turns[:, HUMANOID.index(f"{side}UpperLeg"), 0] = -knee
        turns[:, HUMANOID.index(f"{side}LowerLeg"), 0] = 2 * knee
        turns[:, HUMANOID.index(f"{side}Foot"), 0] = -knee
        turns[:, HUMANOID.index(f"{side}UpperLeg"), 2] = across
    turns[:, HUMANOID.index("leftUpperArm"), 2] = np.sin(2 * math.pi * time).astype(np.float32)
    matrices = matrix_from_axis_angle(turns)
    root = np.zeros((frames, 3), np.float32)
    root[:, 1] = 0.925
    root[:, 0] = pace * time
    quaternions = quaternion_from_matrix(matrices)
    free = Motion(HUMANOID, quaternions, root, 30.0)
    return replayed(Post(HUMANOID, stages=("ground", "feet")), free)


@pytest.fixture(scope="module")
def walk() -> Motion:
    return walking()


def with_options(motion: Motion, options: MotionOptions) -> Motion:
    return replayed(Post(HUMANOID, stages=("leash", "feet")), motion, options=options)


def balls(motion: Motion) -> np.ndarray:
    return motion.pose().positions[:, BALLS]


def test_the_walk_walks(walk: Motion) -> None:
    assert np.ptp(walk.root[:, 0]) > 1.5


def test_in_place_stays_over_the_start_and_feet_step_without_sliding(walk: Motion) -> None:
    still = with_options(walk, MotionOptions(in_place=True))
    assert np.abs(still.root[:, [0, 2]] - walk.root[0, [0, 2]]).max() < 1e-5
    assert skate(balls(still)[30:], 30, standing_height=STANDING) < 0.3
    assert (balls(still)[30:, :, 1] - STANDING).max(0).min() > 0.03  # both feet still lift
    kept = [*HUMANOID.config.parts["upper"], *HUMANOID.config.parts["hands"]]
    dots = np.abs((still.rotations[:, kept] * walk.rotations[:, kept]).sum(-1))
    assert dots.min() > 1 - 1e-5


def lifts(motion: Motion) -> list[int]:
    """How often each foot leaves the floor."""
    high = balls(motion)[30:, :, 1] - STANDING > 0.02
    return [int((high[1:, foot] & ~high[:-1, foot]).sum()) for foot in range(2)]


def test_in_place_feet_step_no_more_often_and_trail_by_less_than_a_third_of_a_metre(walk: Motion) -> None:
    """At a stroll every step stays one step; of one in a hurry no standing foot is stretched far behind."""
    assert lifts(with_options(walk, MotionOptions(in_place=True))) == lifts(walk)
    fast = walking(pace=0.6)
    still = with_options(fast, MotionOptions(in_place=True))
    shown, decoded = balls(still), balls(fast) - fast.root[:, None] + still.root[:, None]
    trail = np.linalg.norm((shown - decoded)[31:, :, ::2], axis=-1)
    stands = np.linalg.norm(np.diff(shown[30:, :, ::2], axis=0), axis=-1) < 1e-3
    assert 0.25 < trail[stands].max() < 0.33


def test_an_idle_stance_bends_the_knees_and_sways_slowly_from_the_start() -> None:
    """The hips are a centimetre lower than at rest; they sway four times in 30 s, and start without a lurch."""
    rest = HUMANOID.offsets[0]
    unit = np.tile(np.float32([1, 0, 0, 0]), (900, HUMANOID.joints, 1))
    still = Motion(HUMANOID, unit, np.tile(rest, (900, 1)).astype(np.float32), 30.0)
    root = with_options(still, MotionOptions(upper_body=True)).root - rest
    assert -0.016 < root[:, 1].min() <= root[:, 1].max() < -0.008
    crossings = ((root[1:] > 0) != (root[:-1] > 0)).sum(0)
    assert 8 <= crossings[0] <= 10
    assert 4 <= crossings[2] <= 6
    assert root[7, 0] < 0.001
    assert root[54, 0] > 0.006


def test_an_idle_stance_sways_on_after_days() -> None:
    """Float32 holds no frame number beyond 2^24, six days; the count begins again before, and nothing shows it."""
    legs, rows = IdleLegs(HUMANOID), np.ones(1, bool)
    state = legs.init_state(1)
    state.frames[:] = 26_061 - 8  # the sway's period is 26,061 frames
    shown = []
    for _ in range(20):
        pose = Pose(np.zeros((1, 8, HUMANOID.joints, 4), np.float32), np.zeros((1, 8, 3), np.float32), 30.0)
        legs.sway(pose, rows, state, np.ones(1, bool))
        shown.append(pose.root[0])
        assert state.frames[0] < 26_061 + 64
    speed = np.linalg.norm(np.diff(np.concatenate(shown), axis=0)[:, ::2], axis=1)
    assert 1e-5 < speed.min() < speed.max() < 5e-4


def test_upper_body_stands_and_keeps_arms_and_fingers(walk: Motion) -> None:
    still = with_options(walk, MotionOptions(upper_body=True))
    feet = balls(still)[15:]
    assert np.ptp(feet, axis=0).max() < 1e-3
    np.testing.assert_allclose(feet[..., 1], np.broadcast_to(STANDING, feet.shape[:2]), atol=2e-3)
    assert 0.005 < np.ptp(still.root[:, 0]) < 0.03  # sways
    kept = [*HUMANOID.config.parts["upper"], *HUMANOID.config.parts["hands"]]
    dots = np.abs((still.rotations[:, kept] * walk.rotations[:, kept]).sum(-1))
    assert dots.min() > 1 - 1e-5


def test_a_leash_holds_a_walker_without_sliding_feet(walk: Motion) -> None:
    led = with_options(walk, MotionOptions(leash_m=0.6))
    away = np.linalg.norm((led.root - walk.root[0])[:, [0, 2]], axis=1)
    assert away.max() <= 0.6
    assert skate(balls(led), 30, standing_height=STANDING) < 0.3
    assert np.abs(np.diff(led.root[:, 0], n=2)).max() < 0.03  # no jerk where the leash ends


def test_free_is_as_it_was(walk: Motion) -> None:
    again = with_options(walk, MotionOptions())
    np.testing.assert_allclose(again.root, walk.root, atol=5e-3)


def test_a_leash_has_a_length() -> None:
    with pytest.raises(ValidationError):
        MotionOptions(leash_m=-1)
