"""Walks are continuous, stay near the origin, and put feet down where they stay."""

import numpy as np
import pytest
from lab.tests.corpora.capture.people import library, stepping, swaying

from echoavatar.errors import MotionError
from echoavatar_lab.corpora.capture.library import CapturedLibrary
from echoavatar_lab.corpora.capture.motion_graph import (
    IDLE,
    TALKING,
    MotionGraph,
    joined,
    overhang,
    standing_graph,
    varied,
    walk,
)
from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, Controls, moved, neutral


def sliding(controls: Controls) -> float:
    """Fastest foot on the floor, metres per second."""
    feet = controls.foot_position
    low = feet[..., 1] < ANKLE_HEIGHT + 0.004
    speed = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1) * 30
    return float(speed[low[1:] & low[:-1]].max())


@pytest.fixture(scope="module")
def graph() -> MotionGraph:
    return MotionGraph([swaying(500, 0.01, 1), swaying(500, 0.02, 2), stepping(900)], [True, True, False])


@pytest.mark.parametrize("wanted", [0.2, 1.0])
def test_a_walk_is_continuous_and_stays(graph: MotionGraph, wanted: float):
    body = walk(graph, np.full(1200, wanted), np.random.default_rng(4))
    assert len(body) == 1200
    assert np.isfinite(body.packed()).all()
    for curve in (body.pelvis_position, body.wrist, body.spine, body.head):
        assert np.abs(np.diff(curve, axis=0)).max() * 30 < 0.6
        assert np.abs(np.diff(curve, 2, axis=0)).max() * 900 < 12
    assert np.linalg.norm(body.pelvis_position[:, [0, 2]], axis=1).max() < 0.6
    assert np.abs(body.pelvis_rotation[:, 0]).max() < 0.8
    assert sliding(body) < 0.08


def test_who_waits_never_does_what_talkers_do():
    people = standing_graph(library())
    calm, lively = (walk(people, np.full(900, x), np.random.default_rng(3)) for x in (IDLE, TALKING))
    assert len(calm) == len(lively) == 900
    assert np.ptp(calm.pelvis_position[:, 0]) < 0.05 < np.ptp(lively.pelvis_position[:, 0])


def test_a_library_without_anybody_who_stands_is_refused():
    with pytest.raises(MotionError, match="standing"):
        standing_graph(CapturedLibrary(library().of("speech")))


def test_liveliness_chooses_what_comes(graph: MotionGraph):
    calm, lively = (walk(graph, np.full(1800, x), np.random.default_rng(1)) for x in (0.2, 1.0))
    assert lively.pelvis_position[:, 0].std() > 2 * calm.pelvis_position[:, 0].std()


def test_a_change_of_liveliness_is_answered_at_once(graph: MotionGraph):
    wanted = np.where(np.arange(900) < 450, 0.2, 1.0)
    body = walk(graph, wanted, np.random.default_rng(2))
    sway = np.abs(np.diff(body.pelvis_position[:, 0]))
    assert sway[500:800].mean() > 2 * sway[150:440].mean()


def test_the_same_seed_is_the_same_walk(graph: MotionGraph):
    first, again = (walk(graph, np.full(300, 1.0), np.random.default_rng(9)).packed() for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_a_near_foot_keeps_its_place_and_a_far_one_steps():
    before = neutral(30)
    kept = joined(before, swaying(90, 0.0))
    assert np.ptp(kept.foot_position, axis=0).max() < 1e-6
    wide = swaying(90, 0.0)
    wide.foot_position[:, 0, 0] += 0.25
    stepped = joined(before, wide)
    assert sliding(stepped) < 0.08
    apart = stepped.foot_position[-1, 0, 0] - stepped.foot_position[-1, 1, 0]
    assert 0.46 - 0.07 <= apart <= 0.465  # the other foot is off by less than 7 cm and stays
    np.testing.assert_allclose(stepped.foot_position[29:31], np.tile(before.foot_position[-1], (2, 1, 1)), atol=2e-3)


def test_a_join_does_not_care_where_the_clip_stood():
    before, after = stepping(60), swaying(120, 0.03, 5)
    elsewhere = moved(after, np.array([3.0, -2.0]), turn=2.5)
    np.testing.assert_allclose(joined(before, after).packed(), joined(before, elsewhere).packed(), atol=2e-3)


def test_sizes_scale_their_curves_and_leave_the_feet():
    body = stepping(300)
    big = varied(body, sway=1.4, lean=2.0, turn=0.7)
    np.testing.assert_array_equal(big.foot_position, body.foot_position)
    assert big.spine[:, 1].std() == pytest.approx(2.0 * body.spine[:, 1].std(), rel=1e-3)
    assert big.spine[:, 0].std() == pytest.approx(0.7 * body.spine[:, 0].std(), rel=1e-3)
    assert overhang(big).max() > overhang(body).max()
