"""Repair of invalid decoded poses: NaN, infinity, or rows from which no rotation can be made.

An invalid rotation is replaced by the joint's previous rotation in the chunk, else by the one shown last, else by rest.
An invalid root does not travel and keeps its height. The length of rotations does not matter: features are made
orthonormal and quaternions are normalised.
"""

import numpy as np
from jaxtyping import Float

from .pose import Array, Pose


def repair(pose: Pose, last: Float[Array, "b j 4"], standing: float) -> int:
    """Repair `pose` in place and return how many rotations and root positions were invalid.

    `pose.root` is still travel here. `last` holds the rotations shown last, zero where there are none. `standing` is
    the height, in metres, of a root that never had a valid one.
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
