"""Rotation arithmetic for torch: batched over any leading axes and differentiable.

Matrices act on column vectors; quaternions are `wxyz`; 6D is the first two *rows* of the matrix, row-major
(Zhou et al. 2019, in the convention the paper's features use). All angles are radians.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

_AXES = {"x": 0, "y": 1, "z": 2}


def matrix_to_6d(matrix: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 6"]:
    """The first two rows, flattened."""
    return matrix[..., :2, :].flatten(-2)


def matrix_from_6d(six: Float[Tensor, "*n 6"]) -> Float[Tensor, "*n 3 3"]:
    """Gram-Schmidt on the two rows; any finite, non-parallel input becomes a proper rotation."""
    a, b = six[..., :3], six[..., 3:]
    first = F.normalize(a, dim=-1, eps=1e-8)
    second = F.normalize(b - (first * b).sum(-1, keepdim=True) * first, dim=-1, eps=1e-8)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-2)


def matrix_from_quaternion(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 3 3"]:
    """Rotation matrices of (not necessarily unit) quaternions `wxyz`."""
    w, x, y, z = F.normalize(quaternion, dim=-1).unbind(-1)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        dim=-2,
    )


def quaternion_from_matrix(matrix: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 4"]:
    """Unit quaternions `wxyz` with w >= 0, from the largest of the four candidates (stable everywhere)."""
    m = matrix
    diagonal = torch.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], -1)
    x, y, z = diagonal.unbind(-1)
    squares = torch.stack([1 + x + y + z, 1 + x - y - z, 1 - x + y - z, 1 - x - y + z], -1)
    yz, zx, xy = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    ayz, azx, axy = m[..., 2, 1] + m[..., 1, 2], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 0] + m[..., 0, 1]
    ww, xx, yy, zz = squares.unbind(-1)
    candidates = torch.stack(
        [
            torch.stack([ww, yz, zx, xy], -1),
            torch.stack([yz, xx, axy, azx], -1),
            torch.stack([zx, axy, yy, ayz], -1),
            torch.stack([xy, azx, ayz, zz], -1),
        ],
        dim=-2,
    )
    best = squares.argmax(-1)[..., None, None].expand(*squares.shape[:-1], 1, 4)
    chosen = candidates.gather(-2, best).squeeze(-2)
    return standardize(F.normalize(chosen, dim=-1))


def standardize(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """The same rotation with w >= 0."""
    return torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def quaternion_multiply(a: Float[Tensor, "*n 4"], b: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """Hamilton product: first b, then a."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def quaternion_conjugate(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """The inverse of a unit quaternion."""
    return quaternion * quaternion.new_tensor([1.0, -1.0, -1.0, -1.0])


def matrix_from_axis_angle(axis_angle: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3 3"]:
    """Rotation by the vector's length about its direction; smooth through zero."""
    return matrix_from_quaternion(quaternion_from_axis_angle(axis_angle))


def quaternion_from_axis_angle(axis_angle: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 4"]:
    """Unit quaternion of a rotation vector; smooth through zero."""
    half = axis_angle.square().sum(-1, keepdim=True).clamp_min(1e-24).sqrt() / 2
    return torch.cat([half.cos(), axis_angle * (half.sin() / (2 * half))], -1)


def axis_angle_from_quaternion(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 3"]:
    """Rotation vector, at most pi long."""
    q = standardize(F.normalize(quaternion, dim=-1))
    sine = q[..., 1:].square().sum(-1, keepdim=True).clamp_min(1e-24).sqrt()
    return q[..., 1:] * (2 * torch.atan2(sine, q[..., :1]) / sine)


def euler_from_matrix(matrix: Float[Tensor, "*n 3 3"], order: str) -> Float[Tensor, "*n 3"]:
    """Intrinsic Euler angles in the order of the letters: Rz(a0) Ry(a1) Rx(a2) for "zyx"; at gimbal lock a2 is 0.

    Raises ValueError if the order does not name x, y and z once each.
    """
    if sorted(order) != ["x", "y", "z"]:
        raise ValueError(f"Euler order must name x, y and z once each, got {order!r}")
    i, j, k = (_AXES[axis] for axis in order)
    sign = 1.0 if (i, j, k) in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1.0
    middle = torch.atan2(sign * matrix[..., i, k], torch.hypot(matrix[..., i, i], matrix[..., i, j]))
    is_locked = torch.hypot(matrix[..., i, i], matrix[..., i, j]) < 1e-6
    first = torch.where(
        is_locked,
        torch.atan2(sign * matrix[..., k, j], matrix[..., j, j]),
        torch.atan2(-sign * matrix[..., j, k], matrix[..., k, k]),
    )
    third = torch.where(is_locked, 0.0, torch.atan2(-sign * matrix[..., i, j], matrix[..., i, i]))
    return torch.stack([first, middle, third], -1)


def slerp(
    start: Float[Tensor, "*n 4"], end: Float[Tensor, "*n 4"], weight: Float[Tensor, "*m"] | float
) -> Float[Tensor, "*n 4"]:
    """Shortest-path spherical interpolation; `weight` 0 gives `start`, 1 gives `end`."""
    share = torch.as_tensor(weight, dtype=start.dtype, device=start.device)[..., None]
    rotation = axis_angle_from_quaternion(quaternion_multiply(quaternion_conjugate(start), end))
    return quaternion_multiply(start, quaternion_from_axis_angle(rotation * share))


def least_rotation(start: Float[Tensor, "*n 3"], end: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3 3"]:
    """The rotation by the smallest angle that takes one direction to another.

    Opposite directions take a half turn about any perpendicular axis. Differentiable, also where both are equal.
    """
    a, b = F.normalize(start, dim=-1), F.normalize(end, dim=-1)
    one = torch.eye(3).to(a)
    cosine = (a * b).sum(-1)[..., None, None]
    skew = torch.linalg.cross(torch.linalg.cross(a, b)[..., None, :], -one.expand(*a.shape, 3))
    smallest = 1e-6 if a.dtype == torch.float32 else 1e-12  # of 1 + cosine, which rounding spoils below it
    rotation = one + skew + skew @ skew / (1 + cosine).clamp_min(smallest)
    across = F.normalize(torch.linalg.cross(a, one[a.abs().argmin(-1)]), dim=-1)
    half_turn = 2 * across[..., :, None] * across[..., None, :] - one
    return torch.where(cosine < -1 + smallest, half_turn, rotation)


def angle_between(a: Float[Tensor, "*n 3 3"], b: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n"]:
    """Angle of the rotation from `a` to `b`, in radians; accurate for small angles."""
    relative = a.transpose(-1, -2) @ b
    skew = torch.stack(
        [
            relative[..., 2, 1] - relative[..., 1, 2],
            relative[..., 0, 2] - relative[..., 2, 0],
            relative[..., 1, 0] - relative[..., 0, 1],
        ],
        -1,
    )
    return torch.atan2(skew.norm(dim=-1), relative.diagonal(dim1=-2, dim2=-1).sum(-1) - 1)
