"""Rotations: against the reference release's numbers, and between their forms."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tests import golden as fixtures

from echoavatar.motion.kinematics import rotations as r
from echoavatar_lab.corpora.solver import matrix_from_euler

ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")


def random_quaternions(count: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return r.standardize(torch.nn.functional.normalize(torch.randn(count, 4, generator=generator).double(), dim=-1))


@pytest.fixture(scope="module")
def golden() -> dict[str, torch.Tensor]:
    with np.load(fixtures.golden("reference_release/rotations.npz")) as stored:
        return {key: torch.from_numpy(stored[key]) for key in stored.files}


def test_six_numbers_are_the_reference_convention(golden):
    torch.testing.assert_close(r.matrix_from_6d(golden["r6"]), golden["mat"], atol=1e-6, rtol=0)
    torch.testing.assert_close(r.matrix_to_6d(golden["mat"]), golden["r6_of_mat"], atol=1e-6, rtol=0)


def test_quaternions_are_the_reference_convention(golden):
    torch.testing.assert_close(r.matrix_from_quaternion(golden["quat_wxyz"]), golden["mat_of_quat"], atol=1e-6, rtol=0)
    ours, theirs = r.quaternion_from_matrix(golden["mat"]), golden["quat_wxyz"]
    torch.testing.assert_close((ours * theirs).sum(-1).abs(), torch.ones(64), atol=1e-6, rtol=0)


def test_euler_angles_are_the_reference_convention(golden):
    matrices = matrix_from_euler(golden["euler_zyx_rad"], "zyx")
    torch.testing.assert_close(matrices, golden["mat_of_euler"], atol=1e-6, rtol=0)
    torch.testing.assert_close(r.euler_from_matrix(matrices, "zyx"), golden["euler_of_quat"], atol=1e-6, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_come_back(order):
    matrices = r.matrix_from_quaternion(random_quaternions(200))
    back = matrix_from_euler(r.euler_from_matrix(matrices, order), order)
    torch.testing.assert_close(back, matrices, atol=1e-9, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_survive_gimbal_lock(order):
    angles = torch.tensor([[0.7, np.pi / 2, 0.4], [-0.3, -np.pi / 2, 1.1]], dtype=torch.double)
    matrices = matrix_from_euler(angles, order)
    back = matrix_from_euler(r.euler_from_matrix(matrices, order), order)
    torch.testing.assert_close(back, matrices, atol=1e-6, rtol=0)


def test_order_must_name_each_axis_once():
    with pytest.raises(ValueError, match="once each"):
        r.euler_from_matrix(torch.eye(3), "xyx")


def test_every_form_leads_back():
    q = random_quaternions(300)
    torch.testing.assert_close(r.quaternion_from_matrix(r.matrix_from_quaternion(q)), q)
    torch.testing.assert_close(r.quaternion_from_axis_angle(r.axis_angle_from_quaternion(q)), q)
    matrices = r.matrix_from_quaternion(q)
    torch.testing.assert_close(r.matrix_from_6d(r.matrix_to_6d(matrices)), matrices)


def test_quaternion_product_is_the_matrix_product():
    a, b = random_quaternions(50, 1), random_quaternions(50, 2)
    torch.testing.assert_close(
        r.matrix_from_quaternion(r.quaternion_multiply(a, b)), r.matrix_from_quaternion(a) @ r.matrix_from_quaternion(b)
    )


def test_half_turns_are_exact():
    """Traces of -1 leave only one good candidate among the four."""
    for axis in np.eye(3):
        matrix = torch.from_numpy(2 * np.outer(axis, axis) - np.eye(3))
        assert r.quaternion_from_matrix(matrix).abs().tolist() == [0.0, *axis]


@settings(deadline=None)
@given(st.floats(0, 1))
def test_slerp_turns_at_even_speed(share):
    start, end = (
        torch.tensor([1.0, 0, 0, 0]).double(),
        r.quaternion_from_axis_angle(torch.tensor([0, 2.0, 0]).double()),
    )
    turned = r.axis_angle_from_quaternion(r.slerp(start, end, share))
    torch.testing.assert_close(turned, torch.tensor([0, 2.0 * share, 0], dtype=torch.double), atol=1e-9, rtol=0)


def test_angle_between_is_right_for_tiny_turns():
    axis_angle = torch.tensor([0.0, 3e-7, 4e-7], dtype=torch.double)
    turn = r.matrix_from_axis_angle(axis_angle)
    assert float(r.angle_between(torch.eye(3).double(), turn)) == pytest.approx(5e-7, rel=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_least_rotation_lays_one_direction_on_the_other(dtype):
    a, b = torch.randn(2, 100, 3, generator=torch.Generator().manual_seed(0)).to(dtype)
    there = (r.least_rotation(a, b) @ a[..., None]).squeeze(-1)
    torch.testing.assert_close(*(torch.nn.functional.normalize(x, dim=-1) for x in (there, b)))
    nearly = torch.tensor([[-1.0, 1e-4, 0.0]], dtype=dtype)
    x = torch.tensor([[1.0, 0.0, 0.0]], dtype=dtype)
    rotation = r.least_rotation(x, nearly)
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3, dtype=dtype)[None], atol=1e-4, rtol=0)
    torch.testing.assert_close((rotation @ x[..., None])[..., 0], nearly, atol=1e-3, rtol=0)


def test_opposite_directions_take_half_a_turn_and_equal_ones_none():
    one = torch.eye(3).double()
    half = r.least_rotation(one, -one)
    torch.testing.assert_close((half @ one[..., None]).squeeze(-1), -one, atol=1e-9, rtol=0)
    torch.testing.assert_close(half.det(), torch.ones(3).double())
    torch.testing.assert_close(r.least_rotation(one, 2 * one), one.expand(3, 3, 3))


def test_gradients_are_finite_at_rest():
    six = torch.tensor([1.0, 0, 0, 0, 1, 0], requires_grad=True)
    r.matrix_from_6d(six).sum().backward()
    axis_angle = torch.zeros(3, requires_grad=True)
    r.matrix_from_axis_angle(axis_angle).sum().backward()
    assert torch.isfinite(six.grad).all()
    assert torch.isfinite(axis_angle.grad).all()
    start = torch.eye(3).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda end: r.least_rotation(torch.eye(3).double(), end), start)
