import numpy as np
import pytest

from echoavatar_lab.corpora.gesture.handpath import HAND_WIDTH, WRIST, HandPath


def vector(value: float) -> np.ndarray:
    return np.full(HAND_WIDTH, value, np.float32)


def test_overlapping_moves_end_at_the_last_aim():
    path = HandPath(vector(0.0))
    path.move(0.5, 1.0, vector(0.3))
    path.move(0.8, 1.4, vector(-0.2))
    curve = path.curve(90)
    assert np.all(curve[:15] == 0)
    np.testing.assert_allclose(curve[-1], -0.2, atol=1e-6)


def test_a_move_that_was_to_begin_later_is_dropped():
    path = HandPath(vector(0.0))
    path.move(0.5, 1.0, vector(0.3))
    path.move(1.5, 2.0, vector(-0.5))
    path.move(1.2, 1.6, vector(0.6))
    curve = path.curve(90)[:, 0]
    assert np.all(np.diff(curve) >= 0)
    assert curve[-1] == pytest.approx(0.6, abs=1e-6)


def test_a_followed_curve_is_blended_in_and_left_where_it_ends():
    path = HandPath(vector(0.5))
    path.move(0.1, 0.4, vector(0.0))
    path.follow(1.0, np.linspace(vector(0.2), vector(0.4), 31), 0.5)
    path.move(2.5, 3.0, vector(0.0))
    curve = path.curve(100)[:, 0]
    assert curve[29] == pytest.approx(0.0, abs=1e-6)
    assert curve[60] == pytest.approx(0.4, abs=1e-6)
    assert curve[52] == pytest.approx(0.2 + 0.2 * 22 / 30, abs=1e-3)
    assert curve[-1] == pytest.approx(0.0, abs=1e-6)
    assert np.abs(np.diff(curve[28:62])).max() < 0.04


def test_speed_has_no_steps_even_where_a_move_is_interrupted():
    path = HandPath(vector(0.0))
    path.move(0.5, 1.1, vector(0.3))
    path.move(0.7, 1.3, vector(0.0))
    acceleration = np.diff(path.curve(90)[:, 0], 2) * 900
    assert np.abs(acceleration).max() < 1.5 * 5.78 * 2 * 0.3 / 0.36  # two minimum-jerk peaks at most


def test_too_fast_a_move_takes_longer():
    path = HandPath(vector(0.0))
    aim = vector(0.0)
    aim[WRIST] = (0.0, 0.6, 0.0)
    path.move(0.0, 0.1, aim)
    speed = np.linalg.norm(np.diff(path.curve(60)[:, WRIST], axis=0), axis=-1) * 30
    assert speed.max() == pytest.approx(2.35, rel=0.05)


def test_a_stroke_overshoots_and_settles():
    path = HandPath(vector(0.0))
    path.stroke(0.2, 0.6, vector(0.1), overshoot=0.2)
    curve = path.curve(60)[:, 0]
    assert 0.105 < curve.max() < 0.121
    assert curve[-1] == pytest.approx(0.1, abs=1e-6)


def test_an_arc_bulges_only_on_the_way():
    path = HandPath(vector(0.0))
    path.move(0.0, 1.0, vector(0.0) + np.float32(0.01), np.array([0.0, 0.05, 0.0], np.float32))
    curve = path.curve(45)
    assert curve[15, 1] == pytest.approx(0.055, abs=2e-3)
    assert curve[-1, 1] == pytest.approx(0.01, abs=1e-6)
