"""Rotation arithmetic of the live path: numpy, components first, lanes last, few and wide operations.

A lane is one rotation of one joint in one frame of one session. With the components first, every operation runs over
contiguous lanes, so one session costs few numpy calls and many sessions cost plain loops over memory. `rotations` is
the same arithmetic in torch, batched over leading axes and differentiable; tests hold the two together.
"""

import numpy as np
from jaxtyping import Float

Array = np.ndarray
_PARTNER = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])  # which of a meets which of b
_SIGN = np.array([[1, -1, -1, -1], [1, 1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1]], np.float32)
_CONJUGATE = np.array([1, -1, -1, -1], np.float32)
_LEAST = 1e-12
WIDE = 8192  # numbers: from here on one pass counts for more than few calls
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def _from_pairs() -> Float[Array, "9 16"]:
    """The entries of a rotation matrix as sums of products of two of the quaternion's numbers."""
    table = np.zeros((3, 3, 4, 4), np.float32)
    for i in range(3):
        table[i, i] = np.diag([1 if k in (0, i + 1) else -1 for k in range(4)])
        j, k = (i + 1) % 3, (i + 2) % 3
        table[i, j, i + 1, j + 1] = table[j, i, i + 1, j + 1] = 2
        table[j, i, 0, k + 1], table[i, j, 0, k + 1] = 2, -2
    return table.reshape(9, 16)


_FROM_PAIRS = _from_pairs()


def multiply(a: Float[Array, "4 ..."], b: Float[Array, "4 ..."]) -> Float[Array, "4 ..."]:
    """Hamilton product: first b, then a. Lanes broadcast."""
    pairs = b[_PARTNER]
    pairs *= _SIGN.reshape(4, 4, *([1] * (b.ndim - 1)))
    product: Array = np.add.reduce(pairs * a, axis=1)
    return product


def conjugate(quaternion: Float[Array, "4 ..."]) -> Float[Array, "4 ..."]:
    """The inverse of a unit quaternion."""
    inverse: Array = quaternion * _CONJUGATE.reshape(4, *([1] * (quaternion.ndim - 1)))
    return inverse


def normalized(vector: Float[Array, "c ..."]) -> Float[Array, "c ..."]:
    """Unit length; zero stays zero."""
    size = np.sqrt(dot(vector, vector))
    unit: Array = vector / np.maximum(size, _LEAST)
    return unit


def rotation_vector(quaternion: Float[Array, "4 ..."]) -> Float[Array, "3 ..."]:
    """Rotation vector of a unit quaternion, at most pi long; smooth through zero."""
    sine = np.sqrt(dot(quaternion[1:], quaternion[1:]))
    real = quaternion[0]
    angle = 2 * np.arctan2(sine, np.abs(real))
    share = np.where(sine > 1e-6, angle / np.maximum(sine, 1e-6), 2.0)
    vector: Array = quaternion[1:] * np.where(real < 0, -share, share)
    return vector


def quaternion(vector: Float[Array, "3 ..."]) -> Float[Array, "4 ..."]:
    """Unit quaternion of a rotation vector; smooth through zero."""
    angle = np.sqrt(dot(vector, vector))
    share = np.sinc(angle / (2 * np.pi)) / 2
    made: Array = np.concatenate([np.cos(angle / 2)[None], vector * share])
    return made.astype(vector.dtype, copy=False)


def matrix(
    quaternion: Float[Array, "4 ..."], out: Float[Array, "3 3 ..."] | None = None
) -> Float[Array, "3 3 ..."]:
    """Rotation matrices of unit quaternions."""
    if quaternion.size < WIDE:
        pairs = (quaternion[:, None] * quaternion).reshape(16, -1)
        few: Array = (_FROM_PAIRS @ pairs).reshape(3, 3, *quaternion.shape[1:])
        if out is None:
            return few
        out[...] = few
        return out
    twice = quaternion[1:] + quaternion[1:]
    made: Array = np.multiply(quaternion[1:, None], twice[None], out=out)
    twice *= quaternion[0]
    x, y, z = twice
    rest = 1 - (made[0, 0] + made[1, 1] + made[2, 2])
    made[0, 1] -= z
    made[1, 0] += z
    made[0, 2] += y
    made[2, 0] -= y
    made[1, 2] -= x
    made[2, 1] += x
    for axis in range(3):
        made[axis, axis] += rest
    return made


def from_matrix(rotation: Float[Array, "3 3 ..."]) -> Float[Array, "4 ..."]:
    """Unit quaternions of rotation matrices, accurate for every angle; of either sign."""
    m = rotation
    made = np.empty((4, *m.shape[2:]), m.dtype)
    made[0] = 1 + m[0, 0] + m[1, 1] + m[2, 2]
    np.subtract(m[2, 1], m[1, 2], out=made[1])
    np.subtract(m[0, 2], m[2, 0], out=made[2])
    np.subtract(m[1, 0], m[0, 1], out=made[3])
    is_far = made[0] < 1
    if is_far.any():
        made[:, is_far] = _far(m[:, :, is_far])
    return normalized(made)


def _far(m: Float[Array, "3 3 k"]) -> Float[Array, "4 k"]:
    """Quaternions, not normalised, of turns by more than 120 degrees: from the largest of the four candidates."""
    x, y, z = m[0, 0], m[1, 1], m[2, 2]
    yz, zx, xy = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    ayz, azx, axy = m[2, 1] + m[1, 2], m[0, 2] + m[2, 0], m[1, 0] + m[0, 1]
    squares = np.stack([1 + x + y + z, 1 + x - y - z, 1 - x + y - z, 1 - x - y + z])
    candidates = np.array(
        [
            [squares[0], yz, zx, xy],
            [yz, squares[1], axy, azx],
            [zx, axy, squares[2], ayz],
            [xy, azx, ayz, squares[3]],
        ]
    )
    best = squares.argmax(0)
    chosen: Array = np.take_along_axis(candidates, best[None, None], 0)[0]
    return chosen


def from_two_rows(rows: Float[Array, "6 ..."]) -> Float[Array, "4 ..."]:
    """Unit quaternions of 6D rotations (the first two rows of the matrix), by Gram-Schmidt; zero for parallel rows."""
    first, second = rows[:3], rows[3:]
    frame = np.empty((3, 3, *rows.shape[1:]), rows.dtype)
    frame[0] = first = normalized(first)
    frame[1] = second = normalized(second - first * dot(first, second))
    frame[2] = third = cross(first, second)
    made = from_matrix(frame)
    is_lost = dot(third, third) < 0.5
    if is_lost.any():
        made[:, is_lost] = 0
    return made


def dot(a: Float[Array, "c ..."], b: Float[Array, "c ..."]) -> Float[Array, "..."]:
    """Scalar products."""
    product: Array = np.add.reduce(a * b) if a.size < WIDE else np.einsum("i...,i...->...", a, b)
    return product


def cross(a: Float[Array, "3 ..."], b: Float[Array, "3 ..."]) -> Float[Array, "3 ..."]:
    """Vector products."""
    product: Array = a[_NEXT] * b[_LAST]
    product -= a[_LAST] * b[_NEXT]
    return product


def apply(rotation: Float[Array, "3 3 ..."], vector: Float[Array, "3 ..."]) -> Float[Array, "3 ..."]:
    """Vectors turned by matrices."""
    turned: Array = np.add.reduce(rotation * vector[None], axis=1)
    return turned


def apply_inverse(rotation: Float[Array, "3 3 ..."], vector: Float[Array, "3 ..."]) -> Float[Array, "3 ..."]:
    """Vectors turned back by matrices."""
    turned: Array = np.add.reduce(rotation * vector[:, None])
    return turned
