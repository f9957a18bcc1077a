import numpy as np

from echoavatar_lab.corpora.controls import ANKLE_HEIGHT
from echoavatar_lab.corpora.dance.footwork import Foothold, walk

T = np.arange(0, 6, 1 / 30)
HOLDS = [
    Foothold(0, 1.0, 1.4, (0.3, 0.1), 0.3, lift=0.08, strike=-0.2),
    Foothold(1, 2.0, 3.0, (-0.1, 0.2), -0.1, air=(2.5, -0.1, 0.25, 0.3)),
]


def test_a_planted_foot_does_not_move_at_all() -> None:
    feet = walk(T, HOLDS)
    for side, planted in ((0, (T <= 1.0) | (T >= 1.4)), (1, (T <= 2.0) | (T >= 3.0))):
        both = planted[1:] & planted[:-1]
        both &= np.abs(np.diff(feet.position[:, side, 0])) < 0.05  # the far side of the swing
        assert np.abs(np.diff(feet.position[:, side], axis=0))[both].max() == 0.0


def test_a_swing_lifts_and_lands_where_asked() -> None:
    feet = walk(T, HOLDS)
    np.testing.assert_allclose(feet.position[-1, :, ::2], [[0.3, 0.1], [-0.1, 0.2]])
    assert abs(feet.position[:, 0, 1].max() - ANKLE_HEIGHT - 0.08) < 0.005
    assert abs(feet.position[:, 1, 1].max() - ANKLE_HEIGHT - 0.25) < 0.005
    assert feet.position[..., 1].min() >= ANKLE_HEIGHT


def test_the_weight_is_on_the_other_foot_during_a_swing() -> None:
    feet = walk(T, HOLDS)
    assert feet.share[30] < 0.3
    assert feet.share[75] > 0.85
    assert feet.share[0] == 0.5


def test_the_heel_leaves_before_the_foot_and_strikes_first() -> None:
    feet = walk(T, HOLDS)
    assert feet.pitch[29, 0] > 0.05
    assert feet.pitch[np.searchsorted(T, 1.4), 0] < -0.1
    assert feet.pitch[-1, 0] == 0.0


def test_no_step_in_speed() -> None:
    fine = np.arange(0, 6, 1 / 300)
    feet = walk(fine, HOLDS)
    assert np.abs(np.diff(feet.position, 2, axis=0)).max() * 300**2 < 60
