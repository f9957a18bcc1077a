import numpy as np

from echoavatar_character.body import Body


def test_eyes_are_where_a_person_has_them(body: Body) -> None:
    left, right = body.eyes["Left"], body.eyes["Right"]
    assert 0.055 < left.middle[0] - right.middle[0] < 0.075
    assert 0.011 < left.radius < 0.018


def test_the_jaw_drops_and_the_crown_stays(body: Body) -> None:
    move = body.move("jawOpen")[:13380]
    assert move[:, 1].min() < -0.015
    assert np.abs(move[body.points[:13380, 1] > 1.65]).max() < 1e-4
