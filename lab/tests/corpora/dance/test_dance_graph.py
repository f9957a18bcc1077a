import numpy as np
from lab.tests.corpora.dance.test_phrases import stepping_in_place

from echoavatar_lab.corpora.capture.library import CapturedClip, CapturedLibrary
from echoavatar_lab.corpora.controls import Controls
from echoavatar_lab.corpora.dance.dance_graph import dance_graph, joint_speed, stretches_of


def graph_of(dance: Controls):
    return dance_graph(CapturedLibrary((CapturedClip("a", "dance", "street", "set/a.bvh", "CC0", dance),)))


def test_stretches_are_whole_counts_that_fit_the_tempo():
    dances = graph_of(stepping_in_place(20.0, 0.4))
    fitting, slow = (stretches_of(dances, ("street",), 4, beat_s) for beat_s in (0.32, 6.0))
    assert len(fitting) > 20
    assert not len(slow)
    np.testing.assert_allclose(fitting.rate, 0.4 / 0.32, atol=0.1)
    assert set(fitting.dance) == {0, 1}  # the clip and its mirror image


def test_floor_work_is_left_out():
    dance = stepping_in_place(20.0, 0.4)
    dance.pelvis_position[300:, 1] = 0.4
    stretches = stretches_of(graph_of(dance), ("street",), 4, 0.32)
    assert len(stretches)
    assert max(stretches.first) * 0.4 * 30 < 300


def test_speed_is_that_of_the_fastest_joint():
    half = np.radians(6.0) / 2
    rotations = np.tile(np.array([1.0, 0, 0, 0], np.float32), (3, 2, 1))
    rotations[1:, 1] = [np.cos(half), np.sin(half), 0, 0]
    np.testing.assert_allclose(joint_speed(rotations), [180.0, 0.0, 0.0], atol=0.5)
