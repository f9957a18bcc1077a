"""Decoded poses that are no poses: NaN, infinity, or rows from which no rotation can be made.

A joint whose rotation is not usable keeps the last usable one: of the chunk, else the one shown last, else the rest
pose. A root that is not usable does not travel and keeps its height. Rotations of any length are no problem: features
are made orthonormal and quaternions normalised.
"""

import numpy as np
from jaxtyping import Float

from .pose import Array, Pose


def repair(pose: Pose, last: Float[Array, "b j 4"], standing: float) -> int:
    """Repair in place; returns how many rotations and root positions there were to repair.

    `pose.root` is still travel here. `last` are the rotations shown last, zero where there are none; `standing` is the
    height, in metres, of a root that never had one.
    """
    rotations, root = pose.rotations, pose.root
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.square(rotations).sum(-1)
    bad = ~(size > 0.5) | ~np.isfinite(size)
    for row, frame, joint in np.argwhere(bad):
        before = rotations[row, frame - 1, joint] if frame else last[row, joint]
        rotations[row, frame, joint] = before if before.any() else (1, 0, 0, 0)
    lost = ~np.isfinite(root).all(-1)
    for row, frame in np.argwhere(lost):
        root[row, frame] = 0, root[row, frame - 1, 1] if frame else standing, 0
    return int(bad.sum() + lost.sum())
