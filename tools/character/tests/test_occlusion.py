import numpy as np

from echoavatar_character.occlusion import openness


def test_a_roof_takes_the_sky_and_nothing_else_does() -> None:
    """Two points look up; one lies below a plate of a square metre."""
    plate = np.array([[-0.5, 0.1, -0.5], [0.5, 0.1, -0.5], [0.5, 0.1, 0.5], [-0.5, 0.1, 0.5]])
    points = np.concatenate([plate, [[0, 0, 0], [1.4, 0, 0]]])
    up = np.tile([0.0, 1.0, 0.0], (6, 1))
    seen = openness(points, up, np.array([[0, 1, 2], [0, 2, 3]]), span=4.0, middle=np.zeros(3), bias=0.01)
    assert seen[4] < 0.1
    assert seen[5] > 0.8
    assert (seen[:4] > 0.9).all()
