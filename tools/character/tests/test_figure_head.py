import numpy as np

from echoavatar_character import figure_eyes as eyes
from echoavatar_character import figure_head as head
from echoavatar_character.sdf import project


def test_the_head_is_symmetric_and_its_eyes_are_open() -> None:
    p = np.random.default_rng(0).normal(size=(300, 3)) * 0.08 + [0, 1.58, 0]
    np.testing.assert_allclose(head.head_skin(p), head.head_skin(p * [-1, 1, 1]), atol=1e-9)
    pupil = eyes.EYE + (0, 0, eyes.EYE_RADIUS)
    assert head.head_skin(pupil[None])[0] > 0  # no skin over the pupil
    above = eyes.EYE + (0, 0.012, 0.012)
    assert head.head_skin(above[None])[0] < 0.002  # the lid is there


def test_the_mouth_is_open_and_hollow_and_the_neutral_one_is_closed() -> None:
    between, hollow = np.array([[0.0, 1.5195, 0.090]]), np.array([[0.0, 1.512, 0.060]])
    assert head.head_skin(between)[0] > 0
    assert head.head_skin(hollow)[0] > 0
    assert head.neutral_skin(between)[0] < 0


def test_brows_lie_on_the_skin() -> None:
    start = np.asarray([(0.03, 1.614, 0.085)]) + np.random.default_rng(1).normal(size=(40, 3)) * 0.002
    on = project(head.brow, start, passes=8)
    assert np.abs(head.head_skin(on)).max() < 0.008
