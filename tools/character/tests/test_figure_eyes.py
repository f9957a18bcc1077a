import numpy as np
import pytest

from echoavatar_character import figure_eyes as eyes
from echoavatar_character.figure_eyes import EYE, EYE_RADIUS, IRIS, PUPIL, eyeball
from echoavatar_character.figure_head import head_skin


def test_eyes_look_ahead_with_pupil_inside_iris() -> None:
    mesh, colours = eyeball(1.0)
    front = mesh.positions[np.argmax(mesh.positions[:, 2])]
    np.testing.assert_allclose(front, EYE + (0, 0, EYE_RADIUS), atol=1e-6)
    angle = np.arccos(np.clip(mesh.normals[:, 2], -1, 1))
    assert angle[(colours == PUPIL).all(1)].max() < angle[(colours == IRIS).all(1)].min()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_lashes_lie_on_the_edge_of_the_upper_lid(side: float) -> None:
    mesh = eyes.lashes(side)
    assert (mesh.positions[:, 0] * side > 0).all()
    assert np.abs(head_skin(mesh.positions.astype(float))).max() < 0.004
    a, b, c = (mesh.positions[mesh.triangles[:, i]] for i in range(3))
    out = np.einsum("fi,fi->f", np.cross(b - a, c - a), mesh.normals[mesh.triangles].mean(1))
    assert (out > 0).mean() > 0.99


def test_the_lids_meet_in_the_corners_and_nowhere_between() -> None:
    x = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    opening = eyes.upper_rim(x) - eyes.lower_rim(x)
    np.testing.assert_allclose(opening[[0, -1]], 0, atol=1e-9)
    assert (opening[1:-1] > 0.008).all()
