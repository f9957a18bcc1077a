import numpy as np
import pytest

from echoavatar.evaluation.metrics.kinetic import kinetic_features


def test_speed_along_and_across_the_floor() -> None:
    """One joint at 3 m/s ahead, another at 2 m/s up, the root still: 9 and 4 m2/s2, no acceleration."""
    t = np.arange(60) / 60
    body = np.zeros((60, 3, 3))
    body[:, 1, 2], body[:, 2, 1] = 3 * t, 2 * t
    features = kinetic_features(body, is_published=False).reshape(3, 3)
    np.testing.assert_allclose(features[:, 0], [0, 9, 0], atol=1e-9)
    np.testing.assert_allclose(features[:, 1], [0, 0, 4], atol=1e-9)
    np.testing.assert_allclose(features[:, 2], 0, atol=1e-6)


def test_acceleration_of_a_fall() -> None:
    t = np.arange(60) / 60
    body = np.zeros((60, 2, 3))
    body[:, 1, 1] = -0.5 * 9.81 * t**2
    assert kinetic_features(body, is_published=False)[5] == pytest.approx(9.81, rel=1e-6)


def test_the_published_energy_follows_the_place_of_a_body_at_rest() -> None:
    """(p - p dt) / dt^2 of a joint that never moves, a metre from the root: 3600 - 60."""
    body = np.zeros((60, 2, 3))
    body[:, 1, 0] = 1
    assert kinetic_features(body)[5] == pytest.approx(3540)
    assert kinetic_features(body, is_published=False)[5] == 0
