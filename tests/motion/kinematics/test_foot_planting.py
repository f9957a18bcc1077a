"""Feet that slide a little stand still afterwards, and nothing else is disturbed."""

import numpy as np
import pytest

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.foot_planting import foot_contacts, planted, settle_feet, stances
from echoavatar_lab.data.faults import skate


def one_foot(height, x):
    """One foot, (t, 1, 3)."""
    return np.stack([np.asarray(x, float), np.asarray(height, float), np.zeros(len(height))], -1)[:, None]


def test_a_still_foot_stands_and_does_not_skate():
    place = one_foot(np.full(30, 0.08), np.zeros(30))
    assert planted(place, 30, standing_height=0.08).all()
    assert skate(place, 30) == 0


def test_a_lifted_foot_may_move():
    height = np.concatenate([np.full(20, 0.08), 0.08 + 0.12 * np.sin(np.linspace(0, np.pi, 12)), np.full(20, 0.08)])
    x = np.concatenate([np.zeros(22), np.linspace(0, 0.4, 8), np.full(22, 0.4)])
    place = one_foot(height, x)
    is_planted = planted(place, 30, standing_height=0.08)[:, 0]
    assert is_planted[:19].all()
    assert not is_planted[22:30].any()
    assert is_planted[34:].all()
    assert skate(place, 30, standing_height=0.08) == 0


def test_trembling_near_the_limit_does_not_flicker():
    """2.5 cm is over the height to enter and under the height to leave."""
    height = 0.08 + np.where(np.arange(40) < 10, 0.0, 0.024 + 0.002 * np.sin(np.arange(40)))
    height[10:14] = 0.08 + np.linspace(0.004, 0.024, 4)
    assert planted(one_foot(height, np.zeros(40)), 30, standing_height=0.08).all()
    assert not planted(one_foot(height[14:], np.zeros(26)), 30, standing_height=0.08).any()


FEET = [HUMANOID.index(name) for name in ("leftFoot", "leftToes", "rightFoot", "rightToes")]
REST = HUMANOID.rest_positions[FEET, 1]


def standing(frames: int = 90, drift: float = 0.0, sink: float = 0.0, fps: float = 30.0) -> Motion:
    """The rest pose with slightly bent knees, carried along by `drift` m/s and too high by `sink` metres."""
    turns = np.zeros((frames, 52, 4), np.float32)
    turns[..., 0] = 1
    for name, degrees in (("UpperLeg", -12.0), ("LowerLeg", 24.0), ("Foot", -12.0)):
        for side in ("left", "right"):
            half = np.radians(degrees) / 2
            turns[:, HUMANOID.index(side + name)] = [np.cos(half), np.sin(half), 0, 0]
    root = np.tile(HUMANOID.offsets[0], (frames, 1))
    root[:, 0] += drift * np.arange(frames) / fps
    root[:, 1] += sink - 0.023335
    return Motion(HUMANOID, turns, root.astype(np.float32), fps)


def places_of(motion: Motion) -> np.ndarray:
    return motion.pose().positions[:, FEET]


@pytest.mark.parametrize("drift", [0.01, 0.05])
def test_sliding_feet_stand_still(drift):
    motion = standing(drift=drift)
    before, after = places_of(motion), places_of(settle_feet(motion))
    assert skate(before, 30) == pytest.approx(100 * drift, rel=0.05)
    assert skate(after, 30, standing_height=REST) < 0.3 * skate(before, 30)


def test_feet_come_down_to_the_floor():
    after = places_of(settle_feet(standing(sink=0.015)))
    np.testing.assert_allclose(after[..., 1], np.tile(REST, (90, 1)), atol=2e-4)


def test_the_upper_body_is_left_alone():
    motion = standing(drift=0.05)
    settled = settle_feet(motion)
    legs = [j for j, name in enumerate(HUMANOID.names) if name.endswith(("Leg", "Foot"))]
    others = [j for j in range(52) if j not in legs]
    np.testing.assert_allclose(settled.rotations[:, others], motion.rotations[:, others], atol=1e-6)
    np.testing.assert_allclose(settled.root, motion.root, atol=0.02)


def test_no_jumps_come_in():
    motion = standing(240, drift=0.08)
    path = places_of(settle_feet(motion))
    assert np.abs(np.diff(path, axis=0)).max() * 30 < 1.0


def test_a_lifted_foot_is_not_held():
    motion = standing(60)
    turns = motion.rotations.copy()
    thigh, knee = HUMANOID.index("leftUpperLeg"), HUMANOID.index("leftLowerLeg")
    lift = np.sin(np.linspace(0, np.pi, 20)) * 0.5
    for joint, sign in ((thigh, -1.0), (knee, 2.0)):
        half = (np.radians(-12 if joint == thigh else 24) + sign * lift) / 2
        turns[20:40, joint] = np.stack([np.cos(half), np.sin(half), 0 * half, 0 * half], -1)
    motion = Motion(HUMANOID, turns, motion.root, 30)
    contacts = foot_contacts(motion)
    assert not contacts[26:34, 0].any()
    assert contacts[:, 1].all()
    before, after = places_of(motion), places_of(settle_feet(motion))
    np.testing.assert_allclose(after[29:31, :2], before[29:31, :2], atol=0.02)


def test_stretches_leave_time_for_a_step():
    """Planted throughout while it drifts 20 cm in 60 frames: a new spot every 6 cm, 8 frames between."""
    path = np.zeros((60, 1, 3))
    path[:, 0, 0] = np.linspace(0, 0.2, 60)
    found = stances(np.ones(60, np.bool_), path, 30)
    assert len(found) >= 3
    assert all(b.start - a.stop >= 8 for a, b in zip(found, found[1:], strict=False))


def test_a_flicker_of_contact_is_bridged():
    is_planted = np.ones(40, np.bool_)
    is_planted[[10, 20, 21]] = False
    assert [tuple(stand) for stand in stances(is_planted, np.zeros((40, 1, 3)), 30)] == [(0, 40)]
