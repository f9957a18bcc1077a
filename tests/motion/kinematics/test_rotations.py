"""Rotations: against the reference release's numbers, and between their forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests import golden as fixtures
from tests.motion.kinematics.samples import matrix_from_euler

from echoavatar.motion.kinematics import rotations as r

ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")


def random_quaternions(count: int, seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return r.standardize(r.unit(generator.standard_normal((count, 4))))


@pytest.fixture(scope="module")
def golden() -> dict[str, np.ndarray]:
    with np.load(fixtures.golden("reference_release/rotations.npz")) as stored:
        return {key: stored[key] for key in stored.files}


def test_six_numbers_are_the_reference_convention(golden):
    np.testing.assert_allclose(r.matrix_from_6d(golden["r6"]), golden["mat"], atol=1e-6, rtol=0)
    np.testing.assert_allclose(r.matrix_to_6d(golden["mat"]), golden["r6_of_mat"], atol=1e-6, rtol=0)


def test_quaternions_are_the_reference_convention(golden):
    np.testing.assert_allclose(r.matrix_from_quaternion(golden["quat_wxyz"]), golden["mat_of_quat"], atol=1e-6, rtol=0)
    ours, theirs = r.quaternion_from_matrix(golden["mat"]), golden["quat_wxyz"]
    np.testing.assert_allclose(np.abs((ours * theirs).sum(-1)), np.ones(64, np.float32), atol=1e-6, rtol=0)


def test_euler_angles_are_the_reference_convention(golden):
    matrices = matrix_from_euler(golden["euler_zyx_rad"], "zyx")
    np.testing.assert_allclose(matrices, golden["mat_of_euler"], atol=1e-6, rtol=0)
    np.testing.assert_allclose(r.euler_from_matrix(matrices, "zyx"), golden["euler_of_quat"], atol=1e-6, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_come_back(order):
    matrices = r.matrix_from_quaternion(random_quaternions(200))
    back = matrix_from_euler(r.euler_from_matrix(matrices, order), order)
    np.testing.assert_allclose(back, matrices, atol=1e-9, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_survive_gimbal_lock(order):
    angles = np.array([[0.7, np.pi / 2, 0.4], [-0.3, -np.pi / 2, 1.1]], np.float64)
    matrices = matrix_from_euler(angles, order)
    back = matrix_from_euler(r.euler_from_matrix(matrices, order), order)
    np.testing.assert_allclose(back, matrices, atol=1e-6, rtol=0)


def test_order_must_name_each_axis_once():
    with pytest.raises(ValueError, match="once each"):
        r.euler_from_matrix(np.eye(3, dtype=np.float32), "xyx")


def test_every_form_leads_back():
    q = random_quaternions(300)
    np.testing.assert_allclose(r.quaternion_from_matrix(r.matrix_from_quaternion(q)), q, atol=1e-5)
    np.testing.assert_allclose(r.quaternion_from_axis_angle(r.axis_angle_from_quaternion(q)), q, atol=1e-5)
    matrices = r.matrix_from_quaternion(q)
    np.testing.assert_allclose(r.matrix_from_6d(r.matrix_to_6d(matrices)), matrices, atol=1e-5)


def test_quaternion_product_is_the_matrix_product():
    a, b = random_quaternions(50, 1), random_quaternions(50, 2)
    np.testing.assert_allclose(
        r.matrix_from_quaternion(r.quaternion_multiply(a, b)),
        r.matrix_from_quaternion(a) @ r.matrix_from_quaternion(b),
        atol=1e-5,
    )


def test_half_turns_are_exact():
    """Traces of -1 leave only one good candidate among the four."""
    for axis in np.eye(3):
        matrix = 2 * np.outer(axis, axis) - np.eye(3)
        assert np.abs(r.quaternion_from_matrix(matrix)).tolist() == [0.0, *axis]


@settings(deadline=None)
@given(st.floats(0, 1))
def test_slerp_turns_at_even_speed(share):
    start, end = np.array([1.0, 0, 0, 0]), r.quaternion_from_axis_angle(np.array([0, 2.0, 0]))
    turned = r.axis_angle_from_quaternion(r.slerp(start, end, share))
    np.testing.assert_allclose(turned, np.array([0, 2.0 * share, 0], np.float64), atol=1e-9, rtol=0)


def test_angle_between_is_right_for_tiny_turns():
    axis_angle = np.array([0.0, 3e-7, 4e-7], np.float64)
    turn = r.matrix_from_axis_angle(axis_angle)
    assert float(r.angle_between(np.eye(3), turn)) == pytest.approx(5e-7, rel=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_least_rotation_lays_one_direction_on_the_other(dtype):
    a, b = np.random.default_rng(0).standard_normal((2, 100, 3)).astype(dtype)
    there = (r.least_rotation(a, b) @ a[..., None])[..., 0]
    np.testing.assert_allclose(*(r.unit(x) for x in (there, b)), atol=1e-5)
    nearly = np.array([[-1.0, 1e-4, 0.0]], dtype)
    x = np.array([[1.0, 0.0, 0.0]], dtype)
    rotation = r.least_rotation(x, nearly)
    np.testing.assert_allclose(rotation @ rotation.mT, np.eye(3, dtype=dtype)[None], atol=1e-4, rtol=0)
    np.testing.assert_allclose((rotation @ x[..., None])[..., 0], nearly, atol=1e-3, rtol=0)


def test_opposite_directions_take_half_a_turn_and_equal_ones_none():
    one = np.eye(3)
    half = r.least_rotation(one, -one)
    np.testing.assert_allclose((half @ one[..., None])[..., 0], -one, atol=1e-9, rtol=0)
    np.testing.assert_allclose(np.linalg.det(half), np.ones(3), atol=1e-5)
    np.testing.assert_allclose(r.least_rotation(one, 2 * one), np.broadcast_to(one, (3, 3, 3)), atol=1e-5)
