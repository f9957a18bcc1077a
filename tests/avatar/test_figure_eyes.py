import numpy as np

from echoavatar.avatar import figure_eyes as eyes
from echoavatar.avatar.figure_eyes import EYE, EYE_RADIUS, IRIS, PUPIL, eyeball
from echoavatar.avatar.figure_head import head_skin
from echoavatar.avatar.sdf import project


def test_eyes_look_ahead_with_pupil_inside_iris() -> None:
    mesh, colours = eyeball(1.0)
    front = mesh.positions[np.argmax(mesh.positions[:, 2])]
    np.testing.assert_allclose(front, EYE + (0, 0, EYE_RADIUS), atol=1e-6)
    angle = np.arccos(np.clip(mesh.normals[:, 2], -1, 1))
    assert angle[(colours == PUPIL).all(1)].max() < angle[(colours == IRIS).all(1)].min()


def test_lashes_lie_on_the_edge_of_the_upper_lid() -> None:
    start = np.asarray([[0.033, 1.594, 0.078]]) + np.random.default_rng(1).normal(size=(40, 3)) * 0.002
    on = project(eyes.lashes, start, passes=8)
    assert np.abs(head_skin(on)).max() < 0.008


def test_the_lids_meet_in_the_corners_and_nowhere_between() -> None:
    x = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    opening = eyes.upper_rim(x) - eyes.lower_rim(x)
    np.testing.assert_allclose(opening[[0, -1]], 0, atol=1e-9)
    assert (opening[1:-1] > 0.008).all()
