import numpy as np

from echoavatar_character.face_points import FacePoints, around, bell, moves
from echoavatar_character.figure_mouth import HEIGHT, WIDE


def test_points_know_where_they_are_about_the_mouth() -> None:
    at = np.array([[0.0, HEIGHT + 0.01, 0.09], [WIDE + 0.004, HEIGHT, 0.08], [0.0, HEIGHT, -0.08]])
    f = FacePoints("skin", at, np.ones(3))
    np.testing.assert_allclose(f.height[0], 0.01)
    np.testing.assert_allclose(f.beyond, [0, 0.004, 0], atol=1e-9)
    np.testing.assert_allclose(f.front, [1, 1, 0], atol=0.05)


def test_mirroring_swaps_sides_and_eyes() -> None:
    f = FacePoints("left eye", np.array([[0.03, 1.58, 0.07]]), np.ones(1))
    assert f.mirrored().part == "right eye"
    np.testing.assert_allclose(f.mirrored().at[0, 0], -0.03)
    assert f.mirrored().mirrored().part == "left eye"


def test_bells_are_one_in_the_middle_and_die_away() -> None:
    np.testing.assert_allclose(bell(np.array([0.0, 1.0, 5.0]), 1.0), [1, np.exp(-1), 0], atol=1e-9)
    np.testing.assert_allclose(around(np.zeros((1, 3)), (0, 0, 0), (1, 1, 1)), 1)


def test_moves_fill_what_is_not_said() -> None:
    np.testing.assert_allclose(moves(0.0, np.array([1.0, 2.0])), [[0, 1, 0], [0, 2, 0]])
