"""Decoded poses that are no poses: NaN, infinity, or rows from which no rotation can be made.

A joint whose rotation is not usable keeps the last usable one: of the chunk, else the one shown last, else the rest
pose. A root that is not usable does not travel and keeps its height. Rotations of any length are no problem: features
are made orthonormal and quaternions normalised.
"""

import numpy as np
from jaxtyping import Float

from .pose import Array, PoseLanes


def repair(pose: PoseLanes, shown: Float[Array, "b j 4 8"], standing: float) -> int:
    """Repair in place; returns how many rotations and root positions there were to repair.

    `pose.root` is still travel here; `standing` is the height, in metres, of a root that never had one.
    """
    turns, root = pose.by_frame(), pose.path()
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.square(turns).sum(0)
    bad = ~(size > 0.5) | ~np.isfinite(size)
    for joint, frame, row in np.argwhere(bad):
        before = turns[:, joint, frame - 1, row] if frame else shown[row, joint, :, -1]
        turns[:, joint, frame, row] = before if before.any() else (1, 0, 0, 0)
    lost = ~np.isfinite(root).all(0)
    for frame, row in np.argwhere(lost):
        height = root[1, frame - 1, row] if frame else standing
        root[:, frame, row] = 0, height, 0
    return int(bad.sum() + lost.sum())
