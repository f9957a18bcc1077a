import numpy as np
import pytest

from echoavatar.motion.kinematics.contact import planted, skate


def feet(height, x):
    """One foot, (t, 1, 3)."""
    return np.stack([np.asarray(x, float), np.asarray(height, float), np.zeros(len(height))], -1)[:, None]


def test_a_still_foot_stands_and_does_not_skate():
    place = feet(np.full(30, 0.08), np.zeros(30))
    assert planted(place, 30, standing_height=0.08).all()
    assert skate(place, 30) == 0


def test_a_sliding_foot_cannot_hide():
    """Half a metre per second along the floor is 50 cm/s of skate, however fast that is."""
    place = feet(np.full(30, 0.08), np.arange(30) * 0.5 / 30)
    assert planted(place, 30).all()
    assert skate(place, 30) == pytest.approx(50)


def test_one_of_two_feet_sliding_is_half():
    still, sliding = feet(np.full(30, 0.08), np.zeros(30)), feet(np.full(30, 0.08), np.arange(30) * 0.2 / 30)
    assert skate(np.concatenate([still, sliding], 1), 30) == pytest.approx(10)


def test_a_lifted_foot_may_move():
    height = np.concatenate([np.full(20, 0.08), 0.08 + 0.12 * np.sin(np.linspace(0, np.pi, 12)), np.full(20, 0.08)])
    x = np.concatenate([np.zeros(22), np.linspace(0, 0.4, 8), np.full(22, 0.4)])
    place = feet(height, x)
    is_planted = planted(place, 30, standing_height=0.08)[:, 0]
    assert is_planted[:19].all()
    assert not is_planted[22:30].any()
    assert is_planted[34:].all()
    assert skate(place, 30, standing_height=0.08) == 0


def test_trembling_near_the_limit_does_not_flicker():
    """2.5 cm is over the height to enter and under the height to leave."""
    height = 0.08 + np.where(np.arange(40) < 10, 0.0, 0.024 + 0.002 * np.sin(np.arange(40)))
    height[10:14] = 0.08 + np.linspace(0.004, 0.024, 4)
    assert planted(feet(height, np.zeros(40)), 30, standing_height=0.08).all()
    assert not planted(feet(height[14:], np.zeros(26)), 30, standing_height=0.08).any()


def test_no_contact_is_no_skate():
    assert skate(feet(np.full(10, 0.5), np.arange(10)), 30, standing_height=0.08) == 0
