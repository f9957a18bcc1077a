"""The statistics against values worked out by hand on a body that stands while one thing moves."""

import importlib.util
import math

import numpy as np
import pytest
import torch
from tests.motion.kinematics.samples import DATA, recorded, swaying

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig
from echoavatar_lab.evaluation.metrics import liveliness as lively
from echoavatar_lab.evaluation.metrics.liveliness import POINTS, STATISTICS, arm_rests, body_points, liveliness, windows

FPS, FRAMES = 30, 900
TIME = np.arange(FRAMES) / FPS
PLACES = {"hips": (0, 1, 0), "head": (0, 1.6, 0), "UpperArm": (0.2, 1.4, 0), "LowerArm": (0.2, 1.1, 0)} | {
    "Hand": (0.2, 0.8, 0),
    "UpperLeg": (0.1, 1, 0),
    "Foot": (0.1, 0.1, 0),
}
ARM = 0.6


def standing() -> np.ndarray:
    points = np.zeros((FRAMES, len(POINTS), 3))
    for number, name in enumerate(POINTS):
        side = -1 if name.startswith("right") else 1
        points[:, number] = np.array(PLACES[name.removeprefix("left").removeprefix("right")]) * (side, 1, 1)
    return points


def at(name: str) -> int:
    return POINTS.index(name)


def test_a_body_that_stands_has_still_hands_in_one_place() -> None:
    found = liveliness(standing(), FPS)
    assert list(found) == list(STATISTICS)
    assert found.pop("hands_still") == 1
    assert found.pop("room") == 2  # a cube for each hand
    assert list(found.values()) == pytest.approx([0] * 7, abs=1e-9)


def test_a_hand_that_flies_off_at_an_arm_length_a_second() -> None:
    """20 s pass 133 cubes; seconds 3.1 s apart differ by 3.1 in one coordinate of six."""
    points = standing()
    points[:, at("leftHand"), 2] += ARM * TIME
    points[:, at("leftHand")] += (0, 1e-6, 0)  # off the edge of a cube
    fixed = np.linalg.norm(points[0, at("leftLowerArm")] - points[0, at("leftUpperArm")])
    paths = lively.hand_paths(points)
    arm = fixed + np.median(np.linalg.norm(points[:, at("leftLowerArm")] - points[:, at("leftHand")], axis=1))
    np.testing.assert_allclose(np.diff(paths[:, 0, 2]) * FPS, ARM / arm)
    paths = paths * arm / ARM  # as if the arm had kept its length
    assert lively.room(paths, FPS) == pytest.approx(20 / 0.15 + 1, abs=1)
    assert lively.novelty(paths, FPS) == pytest.approx(3.1 / math.sqrt(6), rel=1e-2)


def test_room_is_that_of_20_seconds_in_stretches_10_seconds_apart() -> None:
    """40 s at rest, but the left hand is in three more cubes in second 25: in two of three stretches."""
    hands = np.full((40 * FPS, 2, 3), 0.15 / 2)
    for number in range(3):
        hands[25 * FPS + 5 * number :, 0, 0][:5] += 0.15 * (number + 1)
    assert lively.room(hands, FPS) == pytest.approx(2 + 3 * 2 / 3)


def test_hands_at_work_need_both() -> None:
    """Circles of 0.1 arm lengths, one a second: 0.628 arm lengths a second, of which the smoothing leaves 0.978."""
    points = standing()
    circle = 0.1 * ARM * np.stack([np.cos(2 * np.pi * TIME), np.sin(2 * np.pi * TIME)], 1)
    points[:, at("leftHand"), :2] += circle
    one = liveliness(points, FPS)
    assert one["hands_at_work"] == one["hands_still"] == 0
    assert one["hand_speed"] == pytest.approx(0.307, rel=0.02)
    points[:, at("rightHand"), :2] += circle
    both = liveliness(points, FPS)
    assert both["hands_at_work"] == 1
    assert both["hand_speed"] == pytest.approx(0.614, rel=0.02)
    assert both["novelty"] == pytest.approx(0, abs=0.01)  # every second is like every other


def test_a_rest_is_as_long_as_both_hands_are_slow() -> None:
    """The left hand sways in seconds 5 to 15, the right one in 12 to 20: rests of 5 and 10 s, half the time."""
    points = standing()
    for side, begin, end in (("left", 5, 15), ("right", 12, 20)):
        sways = (begin <= TIME) & (end > TIME)
        points[sways, at(f"{side}Hand"), 2] += np.abs((TIME[sways] - begin) % 1 - 0.5) * 2 * ARM
        points[sways, at(f"{side}Hand"), 2] -= ARM
    longest, share = arm_rests(points, FPS)
    assert longest == pytest.approx(10, abs=0.2)
    assert share == pytest.approx(0.5, abs=0.02)
    assert arm_rests(standing(), FPS) == (pytest.approx(30, abs=0.1), 1)


def test_shoulders_trunk_hips_and_ankles() -> None:
    """A sine of amplitude a has the deviation a / sqrt 2; an ankle at 0.3 m/s and one that stands make 0.15."""
    points, wave = standing(), np.sin(2 * np.pi * TIME)
    turn, lean = np.radians(20) * wave, np.radians(10) * wave
    for side, sign in (("left", 1), ("right", -1)):
        points[:, at(f"{side}UpperArm")] = np.stack(
            [sign * 0.2 * np.cos(turn), np.full(FRAMES, 1.4), 0.4 * np.tan(lean) - sign * 0.2 * np.sin(turn)], 1
        )
    points[:, at("hips"), 0] += 0.05 * wave
    points[:, at("leftFoot"), 2] += 0.3 * TIME
    found = liveliness(points, FPS)
    assert found["shoulder_turn"] == pytest.approx(20 / math.sqrt(2), rel=1e-3)
    assert found["trunk_lean"] == pytest.approx(10 / math.sqrt(2), rel=1e-3)
    assert found["hip_sway"] == pytest.approx(5 / math.sqrt(2), rel=1e-2)
    assert found["ankle_speed"] == pytest.approx(0.15, rel=1e-2)


def test_jerk_of_a_hand_on_a_circle_is_that_of_the_circle() -> None:
    """r w^3 for one of twelve points; the smoothing takes a known share of a circle."""
    points, radius, pace = standing(), 0.2, 2 * np.pi
    place, turn = at("leftHand"), pace * TIME
    points[:, place, :2] += radius * np.stack([np.cos(turn), np.sin(turn)], 1)
    kept = np.exp(-((pace / 30) ** 2) / 2)
    assert lively.jerk(points, FPS) == pytest.approx(kept * radius * pace**3 / len(POINTS), rel=0.02)


def test_hands_are_measured_from_the_shoulders() -> None:
    """Where the body stands and which way it faces does not count."""
    points = standing()
    points[:, at("leftHand"), 0] += 0.1 * np.sin(TIME)
    turned = points @ np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]) + (3, 0, -2)
    np.testing.assert_allclose(lively.hand_paths(turned), lively.hand_paths(points), atol=1e-9)


def test_windows_are_whole_and_a_short_clip_is_one() -> None:
    assert [len(part) for part in windows(np.zeros((700, 12, 3)), 30, 10)] == [300, 300]
    assert [len(part) for part in windows(np.zeros((200, 12, 3)), 30, 10)] == [200]
    assert math.isnan(lively.novelty(np.zeros((60, 2, 3)), 30))  # no second is 3 s away


def test_bodies_of_any_height_are_scaled_alike() -> None:
    points = body_points(swaying(60))
    height = points[:, at("head"), 1] - np.minimum(points[:, at("leftFoot"), 1], points[:, at("rightFoot"), 1])
    assert np.median(height) == pytest.approx(1.5)


def test_a_wrist_may_be_the_tip_of_the_arm() -> None:
    """FreeMoCap's rig ends in forearms."""
    config = SkeletonConfig(
        names=("pelvis", "neck", "face")
        + tuple(f"{bone}.{s}" for s in "LR" for bone in ("thigh", "shin", "foot", "upper_arm", "forearm")),
        parents=(-1, 0, 1, 0, 3, 4, 1, 6, 0, 8, 9, 1, 11),
        offsets=((0, 1, 0), (0, 0.4, 0), (0, 0.2, 0))
        + ((0.1, 0, 0), (0, -0.5, 0), (0, -0.4, 0), (0.2, 0, 0), (0, -0.3, 0))
        + ((-0.1, 0, 0), (0, -0.5, 0), (0, -0.4, 0), (-0.2, 0, 0), (0, -0.3, 0)),
        tips={"forearm.L": (0.0, -0.3, 0.0), "forearm.R": (0.0, -0.3, 0.0)},
    )
    still = np.tile(np.array([1, 0, 0, 0], np.float32), (5, 13, 1))
    points = body_points(Motion(Skeleton(config), still, np.tile(np.float32([0, 1, 0]), (5, 1)), 30.0))
    np.testing.assert_allclose(points[0, at("leftHand")], (0.2, 0.8, 0), atol=1e-6)


def test_a_body_upside_down_or_unknown_is_refused() -> None:
    motion = swaying(5)
    flipped = np.zeros_like(motion.rotations)
    flipped[..., 0] = 1
    flipped[:, 0] = (0, 0, 0, 1)  # half a turn about Z
    with pytest.raises(MotionError, match="not above the ankles"):
        body_points(Motion(HUMANOID, flipped, motion.root, 30.0))
    names = tuple(f"j{n}" for n in range(HUMANOID.joints))
    update = {"names": names, "vrm": {}, "offsets": ((0.0,) * 3,) * len(names)}
    strange = Skeleton(HUMANOID.config.model_copy(update=update))
    with pytest.raises(MotionError, match="no joint of the rig is known to be hips"):
        body_points(Motion(strange, motion.rotations, motion.root, 30.0))


@pytest.mark.parametrize(
    "name", ["motion_eval_only/zeroeggs_cc_by_nc_nd/067_Speech_2_x_1_0.bvh", "motion_permissive/cmu_dance/05_02.bvh"]
)
def test_the_numbers_are_those_of_the_yardstick(name: str) -> None:
    """The script beside the reference data, on the same file."""
    path, script = recorded(name), DATA.parent / "measure/alive.py"
    if not script.exists():
        pytest.skip("the yardstick is not beside the reference data")
    spec = importlib.util.spec_from_file_location("alive", script)
    assert spec
    assert spec.loader
    alive = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(alive)
    torch.set_num_threads(1)
    motion = read_bvh(path)
    rows = [list(liveliness(part, motion.fps).values()) for part in windows(body_points(motion), motion.fps, 30)]
    assert np.mean(rows, 0) == pytest.approx(list(alive.score(str(path)).values()), rel=2e-3)
