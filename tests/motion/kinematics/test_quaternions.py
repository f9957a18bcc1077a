"""The compiled arithmetic of the live path against that of whole clips."""

import numpy as np
import pytest

from echoavatar.motion.kinematics import quaternions, rotations


def drawn(seed: int, count: int = 50) -> np.ndarray:
    q = np.random.default_rng(seed).standard_normal((count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def each(function, *arguments: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """A compiled function of tuples, row by row."""
    found = [function(*(tuple(row) for row in rows)) for rows in zip(*arguments, strict=True)]
    return np.array(found, np.float64)


def test_products_and_inverses_agree() -> None:
    a, b = drawn(0), drawn(1)
    np.testing.assert_allclose(each(quaternions.multiply, a, b), rotations.quaternion_multiply(a, b), atol=1e-5)
    np.testing.assert_allclose(each(quaternions.conjugate, a), rotations.quaternion_conjugate(a), atol=1e-5)
    np.testing.assert_allclose(each(quaternions.inner_product, a, b), (a * b).sum(-1), atol=1e-5)


def test_vectors_are_rotated_as_by_the_matrix() -> None:
    a, v = drawn(0), 2 * drawn(1)[:, :3]
    matrix = rotations.matrix_from_quaternion(a)
    np.testing.assert_allclose(each(quaternions.rotate, a, v), (matrix @ v[..., None])[..., 0], atol=1e-5)
    np.testing.assert_allclose(each(quaternions.rotate_back, a, v), (matrix.mT @ v[..., None])[..., 0], atol=1e-5)


def test_vector_arithmetic_agrees() -> None:
    a, b = drawn(0)[:, :3], drawn(1)[:, :3]
    np.testing.assert_allclose(each(quaternions.cross, a, b), np.cross(a, b), atol=1e-5)
    np.testing.assert_allclose(each(quaternions.dot, a, b), (a * b).sum(-1), atol=1e-5)
    np.testing.assert_allclose(each(quaternions.plus, a, b), a + b, atol=1e-5)
    np.testing.assert_allclose(each(quaternions.minus, a, b), a - b, atol=1e-5)
    np.testing.assert_allclose(each(quaternions.length, a), np.linalg.norm(a, axis=-1), atol=1e-5)
    assert quaternions.times((1.0, 2.0, 3.0), 2.0) == (2.0, 4.0, 6.0)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 1.0, 3.1])
def test_rotation_vectors_of_any_size_agree(size: float) -> None:
    vector = drawn(2)[:, :3]
    vector *= size / np.linalg.norm(vector, axis=1, keepdims=True)
    wanted = rotations.quaternion_from_axis_angle(vector)
    np.testing.assert_allclose(each(quaternions.from_rotation_vector, vector), wanted, atol=1e-9, rtol=0)


def test_the_least_rotation_takes_one_direction_to_the_other_about_their_normal() -> None:
    a, b = 3 * drawn(3)[:, :3], drawn(4)[:, :3]
    q = each(quaternions.least_rotation, a, b)
    there = each(quaternions.rotate, q, a)
    far = np.linalg.norm(a, axis=1, keepdims=True) / np.linalg.norm(b, axis=1, keepdims=True)
    np.testing.assert_allclose(there, far * b)
    np.testing.assert_allclose((q[:, 1:] * a).sum(1), 0, atol=1e-12)


def test_zero_becomes_no_rotation() -> None:
    assert quaternions.normalized((0.0, 0.0, 0.0, 0.0)) == (1.0, 0.0, 0.0, 0.0)
    assert quaternions.normalized((0.0, 3.0, 0.0, 4.0)) == (0.0, 0.6, 0.0, 0.8)


def test_what_is_written_is_read() -> None:
    out = np.zeros((2, 4), np.float32)
    quaternions.write_quaternion(out[0], (0.5, -0.5, 0.5, 0.5))
    quaternions.write_vector(out[1], (1.0, 2.0, 3.0))
    assert quaternions.read_quaternion(out[0]) == (0.5, -0.5, 0.5, 0.5)
    assert quaternions.read_vector(out[1]) == (1.0, 2.0, 3.0)


def from_rows(rows: np.ndarray) -> np.ndarray:
    return each(quaternions.from_two_rows, rows[:, :3], rows[:, 3:])


HALF_TURNS = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, 0.8, 0]], float)


def test_two_rows_of_any_length_give_the_rotation() -> None:
    """Half turns, whose w is 0, among them."""
    q = np.concatenate([drawn(5, 200), HALF_TURNS])
    rows = rotations.matrix_from_quaternion(q)[:, :2].copy()
    rows[:, 0] *= 3
    rows[:, 1] += 0.5 * rows[:, 0]  # neither unit nor at right angles
    np.testing.assert_allclose(np.abs((from_rows(rows.reshape(-1, 6)) * q).sum(-1)), 1, atol=1e-9)


def test_parallel_rows_and_garbage_give_no_rotation() -> None:
    rows = np.ones((4, 6))
    rows[1, 3:], rows[2, 0], rows[3, 4] = 2.0, np.nan, np.inf
    assert not from_rows(rows).any()
