import dataclasses

import numpy as np

from echoavatar.avatar import figure_head as head
from echoavatar.avatar.sdf import project


def test_the_head_is_symmetric_and_its_eyes_are_open() -> None:
    p = np.random.default_rng(0).normal(size=(300, 3)) * 0.08 + [0, 1.58, 0]
    np.testing.assert_allclose(head.head_skin(p), head.head_skin(p * [-1, 1, 1]), atol=1e-9)
    pupil = head.EYE + (0, 0, head.EYE_RADIUS)
    assert head.head_skin(pupil[None])[0] > 0  # no skin over the pupil
    above = head.EYE + (0, 0.012, 0.012)
    assert head.head_skin(above[None])[0] < 0.002  # the lid is there


def test_closing_the_lids_covers_the_pupil() -> None:
    """The face stays re-posable: a blink is the same field with other numbers."""
    shut = dataclasses.replace(head.NEUTRAL, lid_upper=-0.0066)
    pupil = head.EYE + (0, 0, head.EYE_RADIUS)
    assert head.head_skin(pupil[None], shut)[0] < 0


def test_jaw_drop_moves_the_chin_down_and_nothing_above_the_nose() -> None:
    face = dataclasses.replace(head.NEUTRAL, jaw_drop=0.01)
    chin = project(head.head_skin, np.array([[0.0, 1.470, 0.075]]))
    assert head.head_skin(chin, face)[0] < -0.003
    brow = np.array([[0.0, 1.62, 0.09], [0.07, 1.62, 0.0]])
    np.testing.assert_allclose(head.head_skin(brow, face), head.head_skin(brow), atol=1e-3)


def test_brows_and_lashes_lie_on_the_skin() -> None:
    for stroke, centre in ((head.brow, (0.03, 1.614, 0.085)), (head.lashes, (0.033, 1.594, 0.078))):
        on = project(
            stroke, np.asarray([centre]) + np.random.default_rng(1).normal(size=(40, 3)) * 0.002, passes=8
        )
        assert np.abs(head.head_skin(on)).max() < 0.008
