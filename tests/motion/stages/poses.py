"""Motion as torch tensors to the poses of the live stages and back."""

from collections.abc import Callable, Sequence
from itertools import repeat

import numpy as np
import torch

from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from echoavatar.motion.stages.pose import Pose


def pose_of(rotations: torch.Tensor, root: torch.Tensor, fps: float = 30.0) -> Pose:
    """From rotation matrices (b, t, j, 3, 3) and (b, t, 3)."""
    return from_quaternions(quaternion_from_matrix(rotations), root, fps)


def from_quaternions(quaternions: torch.Tensor, root: torch.Tensor, fps: float = 30.0) -> Pose:
    """From (b, t, j, 4) and (b, t, 3)."""
    turns, places = (np.array(x.numpy(), np.float32, order="C") for x in (quaternions, root))
    return Pose(turns, places, fps)


def quaternions_of(pose: Pose) -> torch.Tensor:
    return torch.from_numpy(pose.rotations.copy())


def matrices_of(pose: Pose) -> torch.Tensor:
    return matrix_from_quaternion(quaternions_of(pose))


def root_of(pose: Pose) -> torch.Tensor:
    return torch.from_numpy(pose.root.copy())


def in_pieces(
    step: Callable[..., torch.Tensor], *clips: torch.Tensor, sizes: Sequence[int] | None = None
) -> torch.Tensor:
    """What `step` makes of the clips (b, t, ...) cut into pieces of these sizes, by default of 8 frames."""
    cut = 8 if sizes is None else list(sizes)
    return torch.cat([step(*pieces) for pieces in zip(*(clip.split(cut, 1) for clip in clips), strict=True)], 1)


def everyone(rows: int) -> np.ndarray:
    return np.fromiter(repeat(True, rows), bool)
