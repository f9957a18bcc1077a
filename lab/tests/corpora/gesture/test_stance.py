import numpy as np
import pytest

from echoavatar.models.generator.manner import Manner
from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, STANDING_FEET
from echoavatar_lab.corpora.gesture.stance import Shift, Step, air, stances, walked, weight_curve


def test_a_step_moves_one_foot_and_only_during_the_step():
    feet = walked(90, [Step(1.0, 1.5, 0, 0.2, 0.1, 0.3)])
    np.testing.assert_array_equal(feet.foot_position[:31, 0], np.tile(STANDING_FEET[0], (31, 1)).astype(np.float32))
    np.testing.assert_allclose(feet.foot_position[45:, 0], [[0.2, ANKLE_HEIGHT, 0.1]] * 45, atol=1e-6)
    assert np.ptp(feet.foot_position[:, 1], axis=0).max() == 0
    assert feet.foot_position[:, 0, 1].max() == pytest.approx(ANKLE_HEIGHT + 0.045, abs=2e-3)
    assert feet.foot_pitch[-1, 0] == 0


def test_flight_starts_and_lands_softly():
    flight = air(np.linspace(0, 1, 101))
    assert flight[0] == flight[-1] == 0
    assert flight[50] == pytest.approx(1.0)
    assert abs(flight[1]) < 1e-4


def test_weight_arrives_with_each_shift():
    weight = weight_curve(120, [Shift(1.0, 2.0, 1.0), Shift(2.5, 3.0, -0.5)], start=-1.0)
    assert weight[0] == weight[29] == -1
    assert weight[65] == pytest.approx(1.0)
    assert weight[-1] == pytest.approx(-0.5)


def test_a_stepping_foot_never_carries_the_weight():
    steps, shifts = stances(600.0, [(0.0, 600.0)], np.random.default_rng(5), Manner(), 0.5)
    weight = weight_curve(18_000, shifts, 0.5)
    for step in steps:
        middle = weight[round((step.begin + step.end) / 2 * 30)]
        assert middle * (-1 if step.side == 0 else 1) > 0.4


def test_speakers_step_and_listeners_hardly():
    counts = [
        len(stances(600.0, phrases, np.random.default_rng(5), Manner(), 0.5)[0]) for phrases in ([(0.0, 600.0)], [])
    ]
    assert counts[0] > 100
    assert counts[1] < counts[0] / 5


def test_stances_stay_near_the_middle_and_feet_apart():
    steps, _ = stances(600.0, [(0.0, 600.0)], np.random.default_rng(2), Manner(liveliness=0.3), 0.5)
    feet = walked(18_000, steps).foot_position
    assert np.abs(feet[..., [0, 2]]).max() < 0.55
    assert np.linalg.norm(feet[::30, 0] - feet[::30, 1], axis=-1).min() > 0.09
