import numpy as np

from echoavatar_lab.corpora.controls import air
from echoavatar_lab.corpora.keyframes import gaps, glide, progress


def test_a_glide_is_at_each_key_on_time_and_still_there() -> None:
    arrive, values = np.array([1.0, 1.5, 3.0]), np.array([[0.0], [2.0], [-1.0]])
    at_keys = glide(arrive, arrive, values)
    step = 1e-3
    speed = (glide(arrive + step, arrive, values) - glide(arrive - step, arrive, values)) / (2 * step)
    np.testing.assert_allclose(at_keys, values, atol=1e-12)
    assert np.abs(speed).max() < 1e-3


def test_travel_delays_the_departure() -> None:
    arrive, values = np.array([0.0, 2.0]), np.array([[0.0], [1.0]])
    t = np.array([1.0, 1.4, 1.6, 2.0, 5.0])
    late = glide(t, arrive, values, np.array([0.5, 0.5]))[:, 0]
    assert late[0] == late[1] == 0.0
    assert 0.0 < late[2] < 1.0
    assert late[3] == late[4] == 1.0


def test_travel_never_exceeds_the_gap() -> None:
    np.testing.assert_allclose(gaps(np.array([0.0, 0.4, 2.4]), np.array([1.0, 1.0, 1.0])), [1.0, 0.4, 1.0])


def test_progress_names_the_keys_before_and_after() -> None:
    before, after, phase = progress(np.array([-1.0, 0.5, 9.0]), np.array([0.0, 1.0]), np.array([0.5, 1.0]))
    assert before.tolist() == [0, 0, 1]
    assert after.tolist() == [0, 1, 1]
    np.testing.assert_allclose(phase, [0.0, 0.5, 1.0])


def test_a_step_through_the_air_has_no_corner() -> None:
    s = np.linspace(-0.5, 1.5, 2001)
    curve = air(s)
    assert curve.max() == 1.0
    assert curve[s <= 0].max() == 0.0
    assert np.abs(np.diff(curve, 2)).max() < 60 * (s[1] - s[0]) ** 2
