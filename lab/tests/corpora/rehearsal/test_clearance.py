import numpy as np

from echoavatar_lab.corpora.controls import Controls, neutral
from echoavatar_lab.corpora.rehearsal.clearance import _points, keep_hands_clear


def sent(*wrist: float) -> Controls:
    controls = neutral(30)
    controls.wrist[:] = wrist
    return controls


def inside_torso(controls: Controls) -> bool:
    points = _points(controls, 0).numpy()
    return bool(((points[..., 0] / 0.155) ** 2 + ((points[..., 2] - 0.01) / 0.12) ** 2 < 1).any())


def test_a_hand_in_the_belly_is_pushed_out():
    controls = sent(-0.10, -0.35, 0.06)
    assert inside_torso(controls)
    assert not inside_torso(keep_hands_clear(controls))


def test_a_hand_in_the_head_is_pushed_out():
    controls = sent(-0.16, 0.25, 0.05)
    centre = np.array([0.0, 0.345, 0.035])

    def nearest(c: Controls) -> float:
        return float(np.linalg.norm(_points(c, 0).numpy()[:, :3] - centre, axis=-1).min())

    assert nearest(controls) < 0.10
    assert nearest(keep_hands_clear(controls)) > 0.12


def test_hands_in_each_other_are_parted():
    controls = sent(-0.12, -0.25, 0.33)

    def gap(c: Controls) -> float:
        left, right = _points(c, 0).numpy()[:, 1], _points(c, 1).numpy()[:, 1] * [-1, 1, 1]
        return float(np.linalg.norm(left - right, axis=-1).min())

    assert gap(controls) < 0.05
    assert gap(keep_hands_clear(controls)) > 0.07


def test_free_hands_are_left_alone():
    for wrist in ((0.0, -0.25, 0.30), (0.11, -0.485, 0.05), (0.3, 0.2, 0.2)):
        moved = keep_hands_clear(sent(*wrist)).wrist - np.float32(wrist)
        assert np.abs(moved).max() < 0.006
