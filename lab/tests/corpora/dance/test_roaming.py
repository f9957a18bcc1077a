from dataclasses import replace

import numpy as np

from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, Controls, neutral
from echoavatar_lab.corpora.dance.grooves import GROOVES, Counts
from echoavatar_lab.corpora.dance.roaming import ASIDE_BY_RULE_M, ASIDE_CAPTURED_M, with_travel

FRAMES, PERIOD = 900, 15


def counts() -> Counts:
    times = np.arange(0.0, 30.0, 0.5)
    return Counts(times, 4, GROOVES["pop"], ((0, len(times), 1.0),), 0.0, 30.0)


def marching() -> Controls:
    """Steps in place, left and right in turns, each foot in the air for six frames of thirty."""
    body = neutral(FRAMES)
    foot = body.foot_position.copy()
    for side in range(2):
        phase = (np.arange(FRAMES) - PERIOD * side) % (2 * PERIOD)
        foot[:, side, 1] += 0.05 * np.where(phase < 8, np.sin(np.pi * phase / 8), 0)
        foot[:, side, 0] += 0.04 * np.where(phase < 8, np.sin(np.pi * phase / 8), 0)
    return replace(body, foot_position=foot)


def travelling(dance: Controls, home: Controls | None = None, aside=ASIDE_BY_RULE_M) -> Controls:
    return with_travel(dance, counts(), home or neutral(FRAMES), np.random.default_rng(2), aside)


def test_a_dance_with_steps_goes_from_side_to_side_and_stays_near_the_middle():
    made = travelling(marching())
    place = made.pelvis_position[:, [0, 2]]
    assert place[:, 0].std() > 0.3
    assert place[:, 0].min() < -0.4
    assert place[:, 0].max() > 0.4
    assert np.hypot(*place.T).max() < 0.9


def test_a_captured_dancer_is_sent_less_far_aside():
    far, near = (
        travelling(marching(), aside=aside).pelvis_position[:, 0] for aside in (ASIDE_BY_RULE_M, ASIDE_CAPTURED_M)
    )
    assert np.abs(near).max() < 0.8 * np.abs(far).max()


def test_feet_that_stand_stay_where_they_are_and_those_that_travel_are_lifted():
    made = travelling(marching())
    speed = np.linalg.norm(np.diff(made.foot_position[..., [0, 2]], axis=0), axis=-1) * 30
    height = np.maximum(made.foot_position[1:, :, 1], made.foot_position[:-1, :, 1]) - ANKLE_HEIGHT
    assert not speed[height < 1e-4].any()
    assert height[speed > 0.5].min() > 0.01


def test_feet_neither_cross_nor_part_further_than_legs_reach():
    made = travelling(marching())
    apart = made.foot_position[:, 0] - made.foot_position[:, 1]
    assert apart[:, 0].min() > 0.1
    assert np.hypot(apart[:, 0], apart[:, 2]).max() < 0.65


def test_a_dance_without_steps_stays_where_it_is():
    still = neutral(FRAMES)
    np.testing.assert_array_equal(travelling(still).packed(), still.packed())


def test_a_dance_that_begins_far_off_comes_back_to_the_middle():
    far = marching()
    far.pelvis_position[:, 2] += 1.5
    far.foot_position[..., 2] += 1.5
    place = travelling(far).pelvis_position
    assert np.abs(place[300:, 2]).max() < 0.8
