"""Matrices in torch, as the rest of the project holds motion, to the octets of the live stages and back."""

from collections.abc import Callable, Sequence
from itertools import repeat

import numpy as np
import torch

from echoavatar.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from echoavatar.nn.octet import LANES, blocks
from echoavatar.pipeline.pose import PoseLanes

ON = np.array([True])


def to_lanes(rotations: torch.Tensor, root: torch.Tensor, fps: float = 30.0) -> PoseLanes:
    """From at most 8 frames (b, t, j, 3, 3) and (b, t, 3)."""
    return from_quaternions(quaternion_from_matrix(rotations), root, fps)


def from_quaternions(quaternions: torch.Tensor, root: torch.Tensor, fps: float = 30.0) -> PoseLanes:
    """From at most 8 frames (b, t, j, 4) and (b, t, 3)."""
    frames = quaternions.shape[1]
    assert 0 < frames <= LANES
    turns, places = blocks(quaternions.permute(0, 2, 3, 1).numpy()), blocks(root.permute(0, 2, 1).numpy())
    return PoseLanes(turns[0].copy(), places[0].copy(), fps, frames)


def quaternions_of(pose: PoseLanes) -> torch.Tensor:
    return torch.from_numpy(pose.by_frame().transpose(3, 2, 1, 0).copy())


def matrices_of(pose: PoseLanes) -> torch.Tensor:
    return matrix_from_quaternion(quaternions_of(pose))


def root_of(pose: PoseLanes) -> torch.Tensor:
    return torch.from_numpy(pose.path().transpose(2, 1, 0).copy())


def in_pieces(
    step: Callable[..., torch.Tensor], *clips: torch.Tensor, sizes: Sequence[int] | None = None
) -> torch.Tensor:
    """What `step` makes of the clips (b, t, ...) cut into pieces of these sizes, by default of 8 frames."""
    cut = LANES if sizes is None else list(sizes)
    return torch.cat(
        [step(*pieces) for pieces in zip(*(clip.split(cut, 1) for clip in clips), strict=True)], 1
    )


def everyone(rows: int) -> np.ndarray:
    return np.fromiter(repeat(True, rows), bool)
