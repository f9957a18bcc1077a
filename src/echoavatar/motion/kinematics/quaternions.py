"""Quaternion and vector arithmetic for compiled loops, one rotation at a time.

Arrays hold float32. Between reading and writing, a quaternion is a tuple of four floats (`wxyz`) and a vector a tuple
of three, in double precision. `rotations` is the arithmetic for whole clips; a test compares the two.
"""

import math

from echoavatar.nn.kernels import kernel

IDENTITY = (1.0, 0.0, 0.0, 0.0)
_PARALLEL = 1e-12  # squared sine of the angle between two rows below which they give no rotation
_SMALLEST = 1e-12  # length of a quaternion below which it counts as zero


@kernel()
def read_vector(v):  # type: ignore[no-untyped-def]
    """The first three numbers of an array as a vector."""
    return float(v[0]), float(v[1]), float(v[2])


@kernel()
def read_quaternion(q):  # type: ignore[no-untyped-def]
    """The first four numbers of an array as a quaternion."""
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])


@kernel()
def write_vector(out, v):  # type: ignore[no-untyped-def]
    """Write a vector into the first three numbers of an array."""
    out[0], out[1], out[2] = v[0], v[1], v[2]


@kernel()
def write_quaternion(out, q):  # type: ignore[no-untyped-def]
    """Write a quaternion into the first four numbers of an array."""
    out[0], out[1], out[2], out[3] = q[0], q[1], q[2], q[3]


@kernel()
def dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel()
def cross(a, b):  # type: ignore[no-untyped-def]
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel()
def plus(a, b):  # type: ignore[no-untyped-def]
    """Sum of vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel()
def minus(a, b):  # type: ignore[no-untyped-def]
    """Difference of vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel()
def times(a, factor):  # type: ignore[no-untyped-def]
    """A vector times a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@kernel()
def length(a):  # type: ignore[no-untyped-def]
    """Length of a vector."""
    return math.sqrt(dot(a, a))


@kernel()
def inner_product(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of quaternions: for unit ones, the cosine of half the angle between them."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@kernel()
def normalized(q):  # type: ignore[no-untyped-def]
    """`q` at unit length; the identity for zero."""
    size = math.sqrt(inner_product(q, q))
    if size < _SMALLEST:
        return IDENTITY
    return q[0] / size, q[1] / size, q[2] / size, q[3] / size


@kernel()
def conjugate(q):  # type: ignore[no-untyped-def]
    """The inverse of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


@kernel()
def multiply(a, b):  # type: ignore[no-untyped-def]
    """Hamilton product: first b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@kernel()
def rotate(q, v):  # type: ignore[no-untyped-def]
    """A vector rotated by a unit quaternion."""
    axis = (q[1], q[2], q[3])
    across = times(cross(axis, v), 2.0)
    return plus(plus(v, times(across, q[0])), cross(axis, across))


@kernel()
def rotate_back(q, v):  # type: ignore[no-untyped-def]
    """A vector rotated by the inverse of a unit quaternion."""
    return rotate(conjugate(q), v)


@kernel()
def from_rotation_vector(v):  # type: ignore[no-untyped-def]
    """The rotation by the vector's length, in radians, about its direction."""
    angle = length(v)
    scale = math.sin(angle / 2.0) / angle if angle > 1e-9 else 0.5
    return math.cos(angle / 2.0), v[0] * scale, v[1] * scale, v[2] * scale


@kernel()
def least_rotation(a, b):  # type: ignore[no-untyped-def]
    """The rotation by the smallest angle that takes the direction of one vector to that of another."""
    axis = cross(a, b)
    return normalized((math.sqrt(dot(a, a) * dot(b, b)) + dot(a, b), axis[0], axis[1], axis[2]))


@kernel()
def from_two_rows(first, second):  # type: ignore[no-untyped-def]
    """The rotation whose matrix has these directions as its first two rows, as by Gram-Schmidt.

    Zeros where the rows are parallel, zero or not finite.
    """
    third = cross(first, second)
    size_first, size_third = dot(first, first), dot(third, third)
    if not size_third > _PARALLEL * (size_first * dot(second, second)):
        return 0.0, 0.0, 0.0, 0.0
    a = times(first, 1.0 / math.sqrt(size_first))
    c = times(third, 1.0 / math.sqrt(size_third))
    b = cross(c, a)
    trace = a[0] + b[1] + c[2]
    if trace > 0.0:
        q = (1.0 + trace, c[1] - b[2], a[2] - c[0], b[0] - a[1])
    elif a[0] > b[1] and a[0] > c[2]:
        q = (c[1] - b[2], 1.0 + a[0] - b[1] - c[2], a[1] + b[0], a[2] + c[0])
    elif b[1] > c[2]:
        q = (a[2] - c[0], a[1] + b[0], 1.0 + b[1] - a[0] - c[2], b[2] + c[1])
    else:
        q = (b[0] - a[1], a[2] + c[0], b[2] + c[1], 1.0 + c[2] - a[0] - b[1])
    return normalized(q)


@kernel()
def between(a, b, share):  # type: ignore[no-untyped-def]
    """The unit quaternion at this share of the way from a to b."""
    side = -share if inner_product(a, b) < 0.0 else share
    rest = 1.0 - share
    return normalized(
        (a[0] * rest + b[0] * side, a[1] * rest + b[1] * side, a[2] * rest + b[2] * side, a[3] * rest + b[3] * side)
    )
