"""Rotation arithmetic in numpy, components first, lanes last: for blends and overlays, which few chunks need.

A lane is one rotation of one joint in one frame. `rotations` is the same arithmetic in torch, batched over leading axes
and differentiable; `octets` is what the compiled loops of the live path use; tests hold them together.
"""

import numpy as np
from jaxtyping import Float

Array = np.ndarray
_PARTNER = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])  # which of a meets which of b
_SIGN = np.array([[1, -1, -1, -1], [1, 1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1]], np.float32)
_CONJUGATE = np.array([1, -1, -1, -1], np.float32)
_LEAST = 1e-12


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


def dot(a: Float[Array, "c ..."], b: Float[Array, "c ..."]) -> Float[Array, "..."]:
    """Scalar products."""
    product: Array = np.add.reduce(a * b)
    return product
