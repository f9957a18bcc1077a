"""Rotation arithmetic for compiled loops, eight frames at once (`nn.octet`): the live path's inner operations.

Vectors are tuples of three octets, quaternions of four (`wxyz`), matrices of nine, row by row. `rotations` is the same
arithmetic in torch; tests hold the two together.
"""

from ..nn.compiled import ONE, ZERO, F
from ..nn.octet import fused, inner, is_any, load, most, root, where

_LEAST = F(1e-12)
_PARALLEL = F(1e-12)  # squared sine of the angle below which two rows are no rotation


@inner()
def dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of vectors."""
    return fused(a[2], b[2], fused(a[1], b[1], a[0] * b[0]))


@inner()
def added(start, a, b):  # type: ignore[no-untyped-def]
    """A number and the scalar product of vectors."""
    return fused(a[2], b[2], fused(a[1], b[1], fused(a[0], b[0], start)))


@inner()
def cross(a, b):  # type: ignore[no-untyped-def]
    """Vector product."""
    return (
        fused(a[1], b[2], -(a[2] * b[1])),
        fused(a[2], b[0], -(a[0] * b[2])),
        fused(a[0], b[1], -(a[1] * b[0])),
    )


@inner()
def plus(a, b):  # type: ignore[no-untyped-def]
    """Sum of vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner()
def minus(a, b):  # type: ignore[no-untyped-def]
    """Difference of vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inner()
def times(a, share):  # type: ignore[no-untyped-def]
    """A vector made longer."""
    return a[0] * share, a[1] * share, a[2] * share


@inner()
def turned(m, v):  # type: ignore[no-untyped-def]
    """A vector turned by a matrix."""
    return dot((m[0], m[1], m[2]), v), dot((m[3], m[4], m[5]), v), dot((m[6], m[7], m[8]), v)


@inner()
def turned_back(m, v):  # type: ignore[no-untyped-def]
    """A vector turned by the inverse of a rotation matrix."""
    return dot((m[0], m[3], m[6]), v), dot((m[1], m[4], m[7]), v), dot((m[2], m[5], m[8]), v)


@inner()
def composed(a, b):  # type: ignore[no-untyped-def]
    """Matrix product: first b, then a."""
    x, y, z = turned(a, (b[0], b[3], b[6])), turned(a, (b[1], b[4], b[7])), turned(a, (b[2], b[5], b[8]))
    return x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]


@inner()
def seen_from(a, b):  # type: ignore[no-untyped-def]
    """The inverse of rotation a, after b."""
    return composed((a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]), b)


@inner()
def multiply(a, b):  # type: ignore[no-untyped-def]
    """Hamilton product: first b, then a."""
    return (
        fused(-a[3], b[3], fused(-a[2], b[2], fused(-a[1], b[1], a[0] * b[0]))),
        fused(-a[3], b[2], fused(a[2], b[3], fused(a[1], b[0], a[0] * b[1]))),
        fused(a[3], b[1], fused(a[2], b[0], fused(-a[1], b[3], a[0] * b[2]))),
        fused(a[3], b[0], fused(-a[2], b[1], fused(a[1], b[2], a[0] * b[3]))),
    )


@inner()
def conjugate(q):  # type: ignore[no-untyped-def]
    """The inverse of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


@inner()
def matrix(q):  # type: ignore[no-untyped-def]
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    x2, y2, z2 = x + x, y + y, z + z
    wx, wy, wz = w * x2, w * y2, w * z2
    return (
        fused(-y, y2, fused(-z, z2, ONE)),
        fused(x, y2, -wz),
        fused(x, z2, wy),
        fused(x, y2, wz),
        fused(-x, x2, fused(-z, z2, ONE)),
        fused(y, z2, -wx),
        fused(x, z2, -wy),
        fused(y, z2, wx),
        fused(-x, x2, fused(-y, y2, ONE)),
    )


@inner()
def quaternion(m):  # type: ignore[no-untyped-def]
    """Unit quaternion of a rotation matrix, accurate for every angle; of either sign."""
    w, x, y, z = m[0] + m[4] + m[8] + ONE, m[7] - m[5], m[2] - m[6], m[3] - m[1]
    is_far = w < ONE  # turned by more than 120 degrees: the largest of the four numbers says the others
    if is_any(is_far):
        yz, zx, xy = m[7] + m[5], m[2] + m[6], m[3] + m[1]
        by_x, by_y, by_z = m[0] - m[4] - m[8] + ONE, m[4] - m[0] - m[8] + ONE, m[8] - m[0] - m[4] + ONE
        best, a, b, c, d = w, w, x, y, z
        is_x = by_x > best
        best, a, b = where(is_x, by_x, best), where(is_x, x, a), where(is_x, by_x, b)
        c, d = where(is_x, xy, c), where(is_x, zx, d)
        is_y = by_y > best
        best, a, b = where(is_y, by_y, best), where(is_y, y, a), where(is_y, xy, b)
        c, d = where(is_y, by_y, c), where(is_y, yz, d)
        is_z = by_z > best
        a, b, c, d = where(is_z, z, a), where(is_z, zx, b), where(is_z, yz, c), where(is_z, by_z, d)
        w, x, y, z = where(is_far, a, w), where(is_far, b, x), where(is_far, c, y), where(is_far, d, z)
    share = ONE / most(root(fused(z, z, fused(y, y, fused(x, x, w * w)))), _LEAST)
    return w * share, x * share, y * share, z * share


@inner()
def from_two_rows(first, second):  # type: ignore[no-untyped-def]
    """Unit quaternion of a 6D rotation (two rows of the matrix), as by Gram-Schmidt; zero for parallel rows.

    The third row first: then no square root waits for another.
    """
    c = cross(first, second)
    aa, bb, cc = dot(first, first), dot(second, second), dot(c, c)
    is_one = cc > _PARALLEL * (aa * bb)  # not of what is not finite
    a, c = times(first, ONE / root(aa)), times(c, ONE / root(cc))
    b = cross(c, a)
    w, x, y, z = quaternion((a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]))
    return where(is_one, w, ZERO), where(is_one, x, ZERO), where(is_one, y, ZERO), where(is_one, z, ZERO)


@inner()
def quaternion_at(turns, row, joint):  # type: ignore[no-untyped-def]
    """A joint's quaternions out of `turns` (b, j, 4, 8)."""
    return (
        load(turns, (row, joint, 0)),
        load(turns, (row, joint, 1)),
        load(turns, (row, joint, 2)),
        load(turns, (row, joint, 3)),
    )


@inner()
def rotation_at(frames, row, slot):  # type: ignore[no-untyped-def]
    """The rotation out of `frames` (b, c, 12, 8), the three rows of (rotation, place)."""
    return (
        load(frames, (row, slot, 0)),
        load(frames, (row, slot, 1)),
        load(frames, (row, slot, 2)),
        load(frames, (row, slot, 4)),
        load(frames, (row, slot, 5)),
        load(frames, (row, slot, 6)),
        load(frames, (row, slot, 8)),
        load(frames, (row, slot, 9)),
        load(frames, (row, slot, 10)),
    )


@inner()
def place_at(frames, row, slot):  # type: ignore[no-untyped-def]
    """The place out of `frames` (b, c, 12, 8)."""
    return load(frames, (row, slot, 3)), load(frames, (row, slot, 7)), load(frames, (row, slot, 11))
