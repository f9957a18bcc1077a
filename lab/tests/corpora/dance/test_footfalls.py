from dataclasses import replace

import numpy as np

from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, neutral
from echoavatar_lab.corpora.dance.footfalls import with_footfalls


def test_a_dragged_foot_is_lifted_and_a_creeping_one_stands():
    body = neutral(90)
    place = body.foot_position.copy()
    place[:, 0, 0] += np.interp(np.arange(90), [30, 42], [0.0, 0.3])  # dragged 30 cm over the floor in 0.4 s
    place[:, 1, 2] += 0.02 * np.arange(90) / 90  # creeps 2 cm in 3 s
    feet = with_footfalls(replace(body, foot_position=place)).foot_position
    assert feet[36, 0, 1] > ANKLE_HEIGHT + 0.04
    slide = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1) * 30
    low = (feet[..., 1] < ANKLE_HEIGHT + 0.01).astype(bool)
    assert slide[low[1:] & low[:-1]].max() < 0.02
    assert np.abs(feet[-1, 0] - place[-1, 0]).max() < 0.02


def test_a_foot_that_turns_on_its_ball_keeps_the_ball_in_place():
    yaw = np.zeros((60, 2), np.float32)
    yaw[:, 0] = np.interp(np.arange(60), [20, 40], [0.0, 0.5])
    feet = with_footfalls(replace(neutral(60), foot_yaw=yaw))
    ball = feet.foot_position[:, 0][:, [0, 2]] + 0.13 * np.stack([np.sin(yaw[:, 0]), np.cos(yaw[:, 0])], -1)
    low = feet.foot_position[:, 0, 1] < ANKLE_HEIGHT + 0.01
    assert np.linalg.norm(np.diff(ball, axis=0), axis=-1)[low[1:] & low[:-1]].max() * 30 < 0.06
