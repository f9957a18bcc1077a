"""An arm of two bones brought to a target by bending the elbow in its own plane and swinging the shoulder.

Closed form on numpy arrays with components first, (3, *n). The same geometry as `kinematics.two_bone`, but the hinge
is the normal of the plane in which the arm already bends, so no rig has to name its elbow's axis, and the bend is
taken in a form without corner at the stretched arm. Few and wide operations: this runs for each chunk of motion.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Array = np.ndarray
STRAIGHT = 0.25  # radians: an elbow straighter than this is bent less than asked, at 0 not at all
LEAST_DROP = 0.15  # metres below the shoulder to which a hand out of reach may be raised
_FOLDED = -0.985  # cosine of the greatest bend
_STRETCHED = float(np.cos(STRAIGHT))
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
_FIRST, _SECOND = np.array([0, 0, 1]), np.array([1, 2, 2])
_CROSS = np.zeros((3, 3, 3), np.float32)  # _CROSS[i, j, k] v_k is the matrix of "v x"
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _CROSS[_i, _j, _k], _CROSS[_j, _i, _k] = -1.0, 1.0


class ArmTurns(NamedTuple):
    """World rotations: `swing` goes on top of the whole arm, `bend` on top of the forearm before that."""

    swing: Float[Array, "3 3 a n"]
    bend: Float[Array, "3 3 a n"]


def reach(
    shoulder: Float[Array, "3 a n"],
    elbow: Float[Array, "3 a n"],
    wrist: Float[Array, "3 a n"],
    target: Float[Array, "3 a n"],
) -> ArmTurns:
    """Turns that bring the wrist to `target`: always to its direction, and to its distance where the elbow allows.

    A low target beyond the almost stretched arm is raised until the arm reaches it. What is out of reach even then, or
    needs a straight arm (which has no plane to bend in) to bend, gets the direction alone, as in the paper.
    """
    bones, wanted = np.stack([elbow - shoulder, wrist - elbow], 1), target - shoulder
    dots = np.einsum("ivan,iwan->vwan", bones, bones)
    squares, ab = dots[0, 0] + dots[1, 1], np.sqrt(dots[0, 0] * dots[1, 1])
    farthest = squares + 2 * np.maximum(dots[0, 1], ab * _STRETCHED)
    room = np.maximum(farthest - np.square(wanted[0]) - np.square(wanted[2]), LEAST_DROP**2)
    wanted[1] = np.maximum(wanted[1], -np.sqrt(room))
    far, by_bone = np.einsum("ian,ian->an", wanted, wanted), np.einsum("ivan,ian->van", bones, wanted)
    cosine = np.minimum(np.maximum(dots[0, 1] / ab, -1), 1)
    angle = np.arccos(cosine)
    share = np.minimum(np.square(angle / STRAIGHT), 1)
    meant = cosine + share * ((far - squares) / (2 * ab) - cosine)
    new = np.minimum(np.maximum(meant, np.minimum(cosine, _FOLDED)), np.maximum(cosine, _STRETCHED))
    more = np.arccos(new) - angle
    sides = np.concatenate([bones, wanted[:, None]], 1)
    crosses = _cross(sides[:, _FIRST], sides[:, _SECOND])
    turn = np.sin(more) / np.maximum(np.sqrt(np.einsum("ian,ian->an", crosses[:, 0], crosses[:, 0])), 1e-9)
    # the forearm bends to l' = by_upper u + by_lower l, so the arm reaches (1 + by_upper) u + by_lower l
    cos = np.cos(more)
    by_upper, by_lower = 1 - turn * dots[1, 1], cos + turn * dots[0, 1]
    size = np.sqrt((squares + 2 * ab * new) * far)
    along = (by_upper * by_bone[0] + by_lower * by_bone[1]) / size
    across = (by_upper * crosses[:, 1] + by_lower * crosses[:, 2]) / size
    turns = turn_matrix(np.stack([along, cos]), np.stack([across, turn * crosses[:, 0]], 1))
    return ArmTurns(turns[:, :, 0], turns[:, :, 1])


def turn_matrix(
    cosine: Float[Array, "v a n"], sine_axis: Float[Array, "3 v a n"]
) -> Float[Array, "3 3 v a n"]:
    """The rotation with this cosine about this axis, whose length is the sine; smooth at no turn, not at a half."""
    matrix: Array = sine_axis[:, None] * (sine_axis / np.maximum(1 + cosine, 1e-4))
    matrix += np.einsum("ijk,k...->ij...", _CROSS, sine_axis)
    matrix.reshape(9, *cosine.shape)[::4] += cosine
    return matrix


def _cross(a: Array, b: Array) -> Array:
    product: Array = a[_NEXT] * b[_LAST] - a[_LAST] * b[_NEXT]
    return product
