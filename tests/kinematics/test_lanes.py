"""The numpy arithmetic of the live path against the torch one."""

import numpy as np
import pytest
import torch

from echoavatar.kinematics import lanes
from echoavatar.kinematics import rotations as torch_side


def drawn(lane_count: int = 200, seed: int = 0) -> np.ndarray:
    quaternion = np.random.default_rng(seed).standard_normal((4, lane_count))
    return quaternion / np.linalg.norm(quaternion, axis=0)


def as_torch(lanes_first: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.moveaxis(lanes_first, 0, -1).copy())


def test_products_and_inverses_agree() -> None:
    a, b = drawn(seed=1), drawn(seed=2)
    torch.testing.assert_close(
        as_torch(lanes.multiply(a, b)), torch_side.quaternion_multiply(as_torch(a), as_torch(b))
    )
    one = lanes.multiply(a, lanes.conjugate(a))
    np.testing.assert_allclose(one[0], 1, atol=1e-6)
    np.testing.assert_allclose(one[1:], 0, atol=1e-6)


def test_lanes_broadcast() -> None:
    a, b = drawn(6).reshape(4, 1, 6), drawn(30).reshape(4, 5, 6)
    whole = lanes.multiply(np.broadcast_to(a, b.shape), b)
    np.testing.assert_allclose(lanes.multiply(a, b), whole, atol=1e-12)


def test_rotation_vectors_agree() -> None:
    q = drawn()
    torch.testing.assert_close(
        as_torch(lanes.rotation_vector(q)), torch_side.axis_angle_from_quaternion(as_torch(q))
    )


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 1.0, 3.1])
def test_vectors_of_any_size_go_there_and_back(size: float) -> None:
    axis = drawn(50)[:3]
    vector = size * axis / np.linalg.norm(axis, axis=0)
    np.testing.assert_allclose(lanes.rotation_vector(lanes.quaternion(vector)), vector, atol=1e-7)


def test_zero_has_no_direction() -> None:
    assert not lanes.normalized(np.zeros((3, 2))).any()
