"""Matrices in torch, as the rest of the project holds motion, to the lanes of the live stages and back."""

import numpy as np
import torch

from echoavatar.ik.chains import Chains
from echoavatar.kinematics import HUMANOID, Skeleton, lanes
from echoavatar.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from echoavatar.pipeline.pose import Legs, PoseLanes


def to_lanes(rotations: torch.Tensor, root: torch.Tensor, fps: float = 30.0) -> PoseLanes:
    """From (b, t, j, 3, 3) and (b, t, 3)."""
    return from_quaternions(quaternion_from_matrix(rotations), root, fps)


def from_quaternions(quaternions: torch.Tensor, root: torch.Tensor, fps: float = 30.0) -> PoseLanes:
    """From (b, t, j, 4) and (b, t, 3)."""
    turns, places = quaternions.permute(3, 2, 1, 0), root.permute(2, 1, 0)
    return PoseLanes(turns.contiguous().numpy().copy(), places.contiguous().numpy().copy(), fps)


def quaternions_of(pose: PoseLanes) -> torch.Tensor:
    return torch.from_numpy(pose.turns.transpose(3, 2, 1, 0).copy())


def matrices_of(pose: PoseLanes) -> torch.Tensor:
    return matrix_from_quaternion(quaternions_of(pose))


def root_of(pose: PoseLanes) -> torch.Tensor:
    return torch.from_numpy(pose.root.transpose(2, 1, 0).copy())


def legs_of(pose: PoseLanes, chains: Chains, skeleton: Skeleton = HUMANOID) -> Legs:
    """Forward kinematics as `Post` does it."""
    local = chains.local_of(pose.flat())
    frames, hips = chains.world(local), local[:3, :3, 0]
    points = lanes.apply(hips[:, :, None], frames[:, 3, [chains.slot[j] for j in skeleton.config.feet]])
    return Legs(frames, hips, points.reshape(3, -1, *pose.root.shape[1:]))


def cut(pose: PoseLanes, sizes: list[int]) -> list[PoseLanes]:
    """The same frames in pieces."""
    ends = np.cumsum(sizes)
    return [
        PoseLanes(pose.turns[:, :, e - n : e].copy(), pose.root[:, e - n : e].copy(), pose.fps)
        for n, e in zip(sizes, ends, strict=True)
    ]
