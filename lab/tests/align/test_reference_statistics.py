"""Matched filters: truth scores 1, ignorance 0, stillness nothing."""

import numpy as np
import pytest
from lab.tests.align.moving_bodies import dips, reference_statistics, scene

from echoavatar.errors import CheckpointError, MotionError
from echoavatar_lab.align.reference_statistics import (
    ReferenceStatistics,
    event_frames,
    measure_reference_statistics,
    response,
)

BEATS = (0.5, 1.0, 1.5)


def measured() -> ReferenceStatistics:
    return measure_reference_statistics([scene(dips(BEATS), beats=BEATS) for _ in range(20)])


def test_motion_that_is_as_the_truth_responds_with_one():
    own = measured()
    assert response(scene(dips(BEATS), beats=BEATS), "beat", own).sum() == pytest.approx(1.0, abs=0.02)
    assert abs(sum(own.beat)) < 1e-9


def test_shallower_dips_respond_less_and_dips_between_the_beats_negatively():
    own = measured()
    shallow = response(scene(dips(BEATS, depth=0.3), beats=BEATS), "beat", own).sum()
    assert 0.2 < shallow < 0.6
    off = response(scene(dips((0.25, 0.75, 1.25, 1.75)), beats=BEATS), "beat", own).sum()
    assert off < -0.3


def test_neither_speed_nor_stillness_is_of_use():
    """Steady motion at any speed responds with nothing; so does a body that hardly moves but dips."""
    own = measured()
    for level in (0.01, 0.5, 2.0):
        assert abs(response(scene(dips((), level=level), beats=BEATS), "beat", own).sum()) < 0.02
    assert abs(response(scene(dips(BEATS, level=0.002), beats=BEATS), "beat", own).sum()) < 0.1


def test_motion_that_does_not_know_of_the_beats_scores_nothing_on_average():
    """100 scenes with dips anywhere: the mean is zero within three standard errors, and the spread is not."""
    random, own = np.random.default_rng(0), measured()
    found = [
        response(scene(dips(random.uniform(0, 2.4, 4)), beats=random.uniform(0.3, 2.0, 3)), "beat", own).sum()
        for _ in range(100)
    ]
    assert abs(np.mean(found)) < 3 * np.std(found) / 10
    assert np.std(found) > 0.1


def test_credit_goes_to_the_frames_that_earn_it():
    per_frame = response(scene(dips((1.0,)), beats=(1.0,)), "beat", measured())
    assert per_frame[25:36].sum() > 0.6 * per_frame.sum()
    assert np.abs(per_frame[45:]).max() < 1e-9


def test_events_whose_profile_does_not_fit_do_not_count():
    assert event_frames(scene(dips(()), beats=(0.1, 1.0, 2.2)), "beat") == [30]


def test_files(tmp_path):
    own = reference_statistics()
    own.save(tmp_path / "y.json")
    assert ReferenceStatistics.load(tmp_path / "y.json") == own
    with pytest.raises(CheckpointError, match="holds no reference statistics"):
        ReferenceStatistics.load(tmp_path / "other.json")


def test_truth_without_events_is_refused():
    with pytest.raises(MotionError, match="fewer than 20 beats and stresses"):
        measure_reference_statistics([scene(dips(()))])
