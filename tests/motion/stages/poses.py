"""Motion as matrices to the poses of the live stages and back."""

from collections.abc import Callable, Sequence
from itertools import repeat

import numpy as np

from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from echoavatar.motion.stages.pose import Pose


def pose_of(rotations: np.ndarray, root: np.ndarray, fps: float = 30.0) -> Pose:
    """From rotation matrices (b, t, j, 3, 3) and (b, t, 3)."""
    return from_quaternions(quaternion_from_matrix(rotations), root, fps)


def from_quaternions(quaternions: np.ndarray, root: np.ndarray, fps: float = 30.0) -> Pose:
    """From (b, t, j, 4) and (b, t, 3)."""
    turns, places = (np.array(x, np.float32, order="C") for x in (quaternions, root))
    return Pose(turns, places, fps)


def quaternions_of(pose: Pose) -> np.ndarray:
    return pose.rotations.copy()


def matrices_of(pose: Pose) -> np.ndarray:
    return matrix_from_quaternion(quaternions_of(pose))


def root_of(pose: Pose) -> np.ndarray:
    return pose.root.copy()


def in_pieces(step: Callable[..., np.ndarray], *clips: np.ndarray, sizes: Sequence[int] | None = None) -> np.ndarray:
    """What `step` makes of the clips (b, t, ...) cut into pieces of these sizes, by default of 8 frames."""
    return np.concatenate([step(*pieces) for pieces in zip(*(cut(clip, sizes) for clip in clips), strict=True)], 1)


def cut(clip: np.ndarray, sizes: Sequence[int] | None = None) -> list[np.ndarray]:
    """The clip (b, t, ...) in pieces of these sizes, by default of 8 frames."""
    return np.split(clip, range(8, clip.shape[1], 8) if sizes is None else np.cumsum(sizes)[:-1], 1)


def everyone(rows: int) -> np.ndarray:
    return np.fromiter(repeat(True, rows), bool)
