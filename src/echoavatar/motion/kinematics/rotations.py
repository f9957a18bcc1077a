"""Rotation arithmetic of whole clips: batched over any leading axes, in the precision of what it is given.

Matrices act on column vectors; quaternions are `wxyz`; 6D is the first two *rows* of the matrix, row-major
(Zhou et al. 2019, in the convention the paper's features use). All angles are radians.
"""

import numpy as np
from jaxtyping import Float

Array = np.ndarray
_AXES = {"x": 0, "y": 1, "z": 2}


def length(vector: Float[Array, "*n c"]) -> Float[Array, "*n 1"]:
    """Length along the last axis, which is kept; infinite where the squares of a file's numbers overflow."""
    with np.errstate(over="ignore"):
        size: Array = np.sqrt(np.square(vector).sum(-1, keepdims=True))
    return size


def unit(vector: Float[Array, "*n c"], least: float = 1e-12) -> Float[Array, "*n c"]:
    """The vector at length 1; a vector shorter than `least` is divided by `least`."""
    direction: Array = vector / np.maximum(length(vector), least)
    return direction


def matrix_to_6d(matrix: Float[Array, "*n 3 3"]) -> Float[Array, "*n 6"]:
    """The first two rows, flattened."""
    return matrix[..., :2, :].reshape(*matrix.shape[:-2], 6)


def matrix_from_6d(six: Float[Array, "*n 6"]) -> Float[Array, "*n 3 3"]:
    """Gram-Schmidt on the two rows; any finite, non-parallel input becomes a proper rotation."""
    a, b = six[..., :3], six[..., 3:]
    first = unit(a, 1e-8)
    second = unit(b - (first * b).sum(-1, keepdims=True) * first, 1e-8)
    return np.stack([first, second, np.cross(first, second)], -2)


def matrix_from_quaternion(quaternion: Float[Array, "*n 4"]) -> Float[Array, "*n 3 3"]:
    """Rotation matrices of (not necessarily unit) quaternions `wxyz`."""
    w, x, y, z = np.moveaxis(unit(quaternion), -1, 0)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return np.stack(rows, -1).reshape(*quaternion.shape[:-1], 3, 3)


def quaternion_from_matrix(matrix: Float[Array, "*n 3 3"]) -> Float[Array, "*n 4"]:
    """Unit quaternions `wxyz` with w >= 0, from the largest of the four candidates (stable everywhere)."""
    m = matrix
    x, y, z = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    ww, xx, yy, zz = 1 + x + y + z, 1 + x - y - z, 1 - x + y - z, 1 - x - y + z
    yz, zx, xy = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    ayz, azx, axy = m[..., 2, 1] + m[..., 1, 2], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 0] + m[..., 0, 1]
    rows = [ww, yz, zx, xy, yz, xx, axy, azx, zx, axy, yy, ayz, xy, azx, ayz, zz]
    candidates = np.stack(rows, -1).reshape(*matrix.shape[:-2], 4, 4)
    best = np.stack([ww, xx, yy, zz], -1).argmax(-1)[..., None, None]
    return standardize(unit(np.take_along_axis(candidates, best, -2)[..., 0, :]))


def standardize(quaternion: Float[Array, "*n 4"]) -> Float[Array, "*n 4"]:
    """The same rotation with w >= 0."""
    return np.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def quaternion_multiply(a: Float[Array, "*n 4"], b: Float[Array, "*n 4"]) -> Float[Array, "*n 4"]:
    """Hamilton product: first b, then a."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def quaternion_conjugate(quaternion: Float[Array, "*n 4"]) -> Float[Array, "*n 4"]:
    """The inverse of a unit quaternion."""
    return np.concatenate([quaternion[..., :1], -quaternion[..., 1:]], -1)


def matrix_from_axis_angle(axis_angle: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """Rotation by the vector's length about its direction; smooth through zero."""
    return matrix_from_quaternion(quaternion_from_axis_angle(axis_angle))


def quaternion_from_axis_angle(axis_angle: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    """Unit quaternion of a rotation vector; smooth through zero."""
    half = np.maximum(length(axis_angle), 1e-12) / 2
    return np.concatenate([np.cos(half), axis_angle * (np.sin(half) / (2 * half))], -1)


def axis_angle_from_quaternion(quaternion: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Rotation vector, at most pi long."""
    q = standardize(unit(quaternion))
    sine = np.maximum(length(q[..., 1:]), 1e-12)
    vector: Array = q[..., 1:] * (2 * np.arctan2(sine, q[..., :1]) / sine)
    return vector


def euler_from_matrix(matrix: Float[Array, "*n 3 3"], order: str) -> Float[Array, "*n 3"]:
    """Intrinsic Euler angles in the order of the letters: Rz(a0) Ry(a1) Rx(a2) for "zyx"; at gimbal lock a2 is 0.

    Raises ValueError if the order does not name x, y and z once each.
    """
    if sorted(order) != ["x", "y", "z"]:
        raise ValueError(f"Euler order must name x, y and z once each, got {order!r}")
    i, j, k = (_AXES[axis] for axis in order)
    sign = 1.0 if (i, j, k) in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1.0
    level = np.hypot(matrix[..., i, i], matrix[..., i, j])
    middle, is_locked = np.arctan2(sign * matrix[..., i, k], level), level < 1e-6
    first = np.where(
        is_locked,
        np.arctan2(sign * matrix[..., k, j], matrix[..., j, j]),
        np.arctan2(-sign * matrix[..., j, k], matrix[..., k, k]),
    )
    third = np.where(is_locked, 0.0, np.arctan2(-sign * matrix[..., i, j], matrix[..., i, i]))
    return np.stack([first, middle, third], -1)


def slerp(
    start: Float[Array, "*n 4"], end: Float[Array, "*n 4"], weight: Float[Array, "*m"] | float
) -> Float[Array, "*n 4"]:
    """Shortest-path spherical interpolation; `weight` 0 gives `start`, 1 gives `end`."""
    rotation = axis_angle_from_quaternion(quaternion_multiply(quaternion_conjugate(start), end))
    share = np.asarray(weight, start.dtype)[..., None]
    return quaternion_multiply(start, quaternion_from_axis_angle(rotation * share))


def least_rotation(start: Float[Array, "*n 3"], end: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """The rotation by the smallest angle that takes one direction to another.

    Opposite directions take a half turn about any perpendicular axis.
    """
    a, b = unit(start), unit(end)
    one = np.eye(3, dtype=a.dtype)
    cosine = (a * b).sum(-1)[..., None, None]
    skew = b[..., :, None] * a[..., None, :] - a[..., :, None] * b[..., None, :]  # of the cross product
    smallest = 1e-6 if a.dtype == np.float32 else 1e-12  # of 1 + cosine, which rounding spoils below it
    rotation = one + skew + skew @ skew / np.maximum(1 + cosine, smallest)
    across = unit(np.cross(a, one[np.abs(a).argmin(-1)]))
    half_turn = 2 * across[..., :, None] * across[..., None, :] - one
    least: Array = np.where(cosine < -1 + smallest, half_turn, rotation)
    return least


def angle_between(a: Float[Array, "*n 3 3"], b: Float[Array, "*n 3 3"]) -> Float[Array, "*n"]:
    """Angle of the rotation from `a` to `b`, in radians; accurate for small angles."""
    relative = a.mT @ b
    skew = (relative - relative.mT)[..., [2, 0, 1], [1, 2, 0]]
    angle: Array = np.arctan2(length(skew)[..., 0], np.trace(relative, axis1=-2, axis2=-1) - 1)
    return angle
