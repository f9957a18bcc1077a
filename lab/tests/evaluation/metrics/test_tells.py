"""The statistics against values worked out by hand on a body that stands while its hands move."""

import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar_lab.evaluation.metrics import tells
from echoavatar_lab.evaluation.metrics.tells import HEARD, JUDGED, SHARING, TELLS, judged_points, loudness

FRAMES, ARM = 900, 0.6
TIME = np.arange(FRAMES) / 30
PLACES = {"hips": (0, 1, 0), "neck": (0, 1.45, 0), "head": (0, 1.6, 0), "UpperArm": (0.2, 1.4, 0)} | {
    "LowerArm": (0.2, 1.1, 0),
    "Hand": (0.2, 0.8, 0),
    "UpperLeg": (0.1, 1, 0),
    "Foot": (0.1, 0.1, 0),
}


def standing() -> np.ndarray:
    points = np.zeros((FRAMES, len(JUDGED), 3))
    for number, name in enumerate(JUDGED):
        side = -1 if name.startswith("right") else 1
        points[:, number] = np.array(PLACES[name.removeprefix("left").removeprefix("right")]) * (side, 1, 1)
    return points


def moved(*paths: tuple[str, int, np.ndarray]) -> np.ndarray:
    """The standing body, with points moved along an axis, in arm lengths."""
    points = standing()
    for name, axis, path in paths:
        points[:, JUDGED.index(name), axis] += ARM * path
    return points


def wave(hertz: float, size: float = 0.2) -> np.ndarray:
    return size * np.sin(2 * np.pi * hertz * TIME)


def test_every_statistic_of_a_body_that_stands_is_a_number_or_missing() -> None:
    found = tells.tells(standing(), np.zeros(FRAMES))
    assert list(found) == [*TELLS, *HEARD]
    assert found["place: to the side"] == pytest.approx(0.2 / ARM)
    assert found["place: mean height"] == pytest.approx(-1)
    assert found["place: elbow angle, deg"] == pytest.approx(180, abs=0.01)
    assert found["hold: a minute"] == pytest.approx(2)
    assert found["hold: mean length, s"] == pytest.approx(30)
    missing = {"stroke: starts over stops", "hands: one-handed strokes", "hands: stay up, median s"}
    assert {name for name in TELLS if not np.isfinite(found[name])} == missing


def test_one_hand_that_waves_alone() -> None:
    found = tells.tells(moved(("leftHand", 1, wave(1))))
    assert found["hands: speeds together"] == found["hands: mirrored velocity"] == 0
    assert found["hands: unequal share of work"] == pytest.approx(1)
    assert found["hands: unequal within 3 s"] == pytest.approx(1)
    assert found["hands: one works, other rests"] > 0.6
    assert found["stroke: mean frequency, Hz"] == pytest.approx(1, abs=0.05)
    assert found["stroke: share above 3 Hz"] < 0.01
    assert found["stroke: speed, 95 %"] == pytest.approx(0.2 * 2 * np.pi, rel=0.03)
    assert tells.tells(moved(("leftHand", 1, wave(1))), table=SHARING)["hands: one-handed strokes"] == 1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_hands_that_mirror_each_other(axis: int) -> None:
    """Mirror images go apart sidewards, and along the other axes together; the opposite is -1."""
    sign = -1 if axis == 0 else 1
    mirrored = moved(("leftHand", axis, wave(1)), ("rightHand", axis, sign * wave(1)))
    found = tells.tells(mirrored)
    assert found["hands: mirrored velocity"] == pytest.approx(1)
    assert found["hands: apart from mirror image"] == pytest.approx(0, abs=1e-9)
    assert found["hands: unequal within 3 s"] == pytest.approx(0, abs=1e-6)
    assert tells.tells(mirrored, table=SHARING)["hands: one-handed strokes"] == 0
    parallel = tells.tells(moved(("leftHand", axis, wave(1)), ("rightHand", axis, -sign * wave(1))))
    assert parallel["hands: mirrored velocity"] == pytest.approx(-1)


def test_hands_that_take_turns_share_the_work_and_yet_not() -> None:
    """Left for 3 s, then right for 3 s: equal in the whole, unequal within 3 s."""
    is_left = (TIME // 3).astype(int) % 2 == 0
    found = tells.tells(moved(("leftHand", 1, wave(1) * is_left), ("rightHand", 1, wave(1) * ~is_left)))
    assert found["hands: unequal share of work"] < 0.02
    assert found["hands: unequal within 3 s"] > 0.95


def test_holds_between_strokes() -> None:
    """A second of waving, a second of rest: 30 holds a minute, each a second long."""
    works = (TIME.astype(int) % 2 == 0) * wave(2)
    found = tells.tells(moved(("leftHand", 1, works), ("rightHand", 1, works)))
    assert found["hold: a minute"] == pytest.approx(30)
    assert found["hold: mean length, s"] == pytest.approx(0.9, abs=0.15)


def test_the_trunk_and_the_head() -> None:
    shoulders = [(f"{side}UpperArm", axis, size) for side in ("left", "right") for axis, size in ((2, wave(0.2, 0.1)),)]
    found = tells.tells(moved(*shoulders))
    lean = np.degrees(np.arctan(ARM * 0.1 / np.sqrt(2) / 0.4))
    assert found["trunk: forwards, sd deg"] == pytest.approx(lean, rel=0.03)
    assert found["trunk: sideways, sd deg"] == pytest.approx(0, abs=1e-6)
    together = tells.tells(moved(*shoulders, ("leftHand", 1, wave(0.2, 0.1))))
    assert together["trunk: moves with hands"] > 0.95
    nods = tells.tells(moved(("head", 2, np.abs(wave(0.5, 0.1)))))
    assert nods["head: against shoulders, sd deg"] > 2
    assert found["head: against shoulders, sd deg"] == pytest.approx(0, abs=1e-3)
    walks = tells.tells(moved(("hips", 2, TIME), ("leftFoot", 2, TIME)))
    assert walks["hips: travel, m/s"] == pytest.approx(ARM, rel=0.01)
    assert walks["feet: time in which one steps"] == 1


def test_where_the_body_faces_and_how_long_its_arms_are_changes_nothing() -> None:
    points = judged_points(swaying(600))
    turn = np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    assert tells.tells(points @ turn.T) == pytest.approx(tells.tells(points), rel=1e-6, abs=1e-9)


def test_motion_of_another_rate_is_judged_at_ours() -> None:
    some, others = (tells.tells(judged_points(swaying(frames, fps))) for frames, fps in ((600, 30.0), (1200, 60.0)))
    del some["stroke: starts over stops"], others["stroke: starts over stops"]  # of tails, which frames between shift
    assert some == pytest.approx(others, rel=0.05, abs=0.02)
    with pytest.raises(MotionError, match=r"0\.50 s of motion cannot be judged"):
        judged_points(swaying(15))


def test_hands_that_follow_the_sound_five_frames_late() -> None:
    loud = np.interp(np.arange(FRAMES), np.arange(0, FRAMES, 9), np.random.default_rng(0).uniform(0.1, 1, 100))
    late = np.concatenate([np.full(5, 0.1), loud[:-5]])
    points = moved(("leftHand", 1, np.cumsum(late * np.where(TIME.astype(int) % 2 == 0, 1, -1)) / 30))
    found = tells.tells(points, loud)
    assert found["sound: loudness and speed, best lag"] > 0.8 > found["sound: loudness and speed, same time"]
    silent = np.where(TIME < 15, loud, 0)
    rests = tells.tells(moved(("leftHand", 1, wave(1) * (TIME < 14.5))), silent)
    assert rests["sound: in pauses, speed over mean"] < 0.1


def test_loudness_is_of_a_peak_of_one() -> None:
    sound = np.repeat([0.1, 0.2, 0.0], 800).astype(np.float32)
    assert loudness(sound) == pytest.approx([0.5, 1, 0], abs=1e-6)
    assert loudness(np.zeros(2000, np.float32)) == pytest.approx([0, 0])


def test_stages_share_their_rows_with_the_jury() -> None:
    points = judged_points(swaying(300))
    shared, judged = tells.tells(points, table=SHARING), tells.tells(points)
    assert list(shared) == list(SHARING)
    assert len(TELLS) == 31
    assert {name: judged[name] for name in SHARING if name in judged} == {n: shared[n] for n in SHARING}
