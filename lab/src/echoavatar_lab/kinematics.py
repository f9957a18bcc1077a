"""The kinematics of `echoavatar.motion` for torch: differentiable, and on a GPU. A test holds both equal.

Training, rewards and the corpus' solver use it; what works on finished clips uses `echoavatar.motion.kinematics`.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.kinematics.features import travel_slice


class Pose(NamedTuple):
    """World rotation matrices and positions of every joint."""

    rotations: Float[Tensor, "*n j 3 3"]
    positions: Float[Tensor, "*n j 3"]


class MotionFrames(NamedTuple):
    """Parent-relative rotation matrices and the root's world position."""

    rotations: Float[Tensor, "*n t j 3 3"]
    root: Float[Tensor, "*n t 3"]


def forward_kinematics(skeleton: Skeleton, rotations: Float[Tensor, "*n j 3 3"], root: Float[Tensor, "*n 3"]) -> Pose:
    """World pose from parent-relative rotations and the root's world position (metres)."""
    world, places, order = [rotations[..., :1, :, :]], [root[..., None, :]], [0]
    for joints, parents, offsets in skeleton.levels:
        above_order, order = order[-world[-1].shape[-3] :], [*order, *joints]
        chosen = torch.tensor([above_order.index(parent) for parent in parents], device=rotations.device)
        above = world[-1].index_select(-3, chosen)
        own = rotations.index_select(-3, torch.tensor(joints, device=rotations.device))
        places.append(places[-1].index_select(-2, chosen) + (above @ torch.from_numpy(offsets).to(above)).squeeze(-1))
        world.append(above @ own)
    back = torch.tensor(order, device=rotations.device).argsort()
    return Pose(torch.cat(world, -3).index_select(-3, back), torch.cat(places, -2).index_select(-2, back))


def from_features(skeleton: Skeleton, features: Float[Tensor, "*n t c"]) -> MotionFrames:
    """Rotations and root from features (Y up); joints outside all parts stay at rest, the root starts at the origin."""
    travel, joints = travel_slice(skeleton), list(skeleton.feature_joints)
    six = torch.cat([features[..., : travel.start], features[..., travel.stop :]], -1)
    rotations = torch.eye(3).to(features).repeat(*features.shape[:-1], skeleton.joints, 1, 1)
    rotations[..., joints, :, :] = matrix_from_6d(six.reshape(*six.shape[:-1], len(joints), 6))
    (x, z), height = features[..., travel][..., :2].cumsum(-2).unbind(-1), features[..., travel][..., 2]
    return MotionFrames(rotations, torch.stack([x, height, z], -1))


def matrix_to_6d(matrix: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 6"]:
    """The first two rows, flattened."""
    return matrix[..., :2, :].flatten(-2)


def matrix_from_6d(six: Float[Tensor, "*n 6"]) -> Float[Tensor, "*n 3 3"]:
    """Gram-Schmidt on the two rows; any finite, non-parallel input becomes a proper rotation."""
    a, b = six[..., :3], six[..., 3:]
    first = F.normalize(a, dim=-1, eps=1e-8)
    second = F.normalize(b - (first * b).sum(-1, keepdim=True) * first, dim=-1, eps=1e-8)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-2)


def matrix_from_quaternion(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 3 3"]:
    """Rotation matrices of (not necessarily unit) quaternions `wxyz`."""
    w, x, y, z = F.normalize(quaternion, dim=-1).unbind(-1)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        dim=-2,
    )


def quaternion_from_matrix(matrix: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 4"]:
    """Unit quaternions `wxyz` with w >= 0, from the largest of the four candidates (stable everywhere)."""
    m = matrix
    diagonal = torch.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], -1)
    x, y, z = diagonal.unbind(-1)
    squares = torch.stack([1 + x + y + z, 1 + x - y - z, 1 - x + y - z, 1 - x - y + z], -1)
    yz, zx, xy = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    ayz, azx, axy = m[..., 2, 1] + m[..., 1, 2], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 0] + m[..., 0, 1]
    ww, xx, yy, zz = squares.unbind(-1)
    candidates = torch.stack(
        [
            torch.stack([ww, yz, zx, xy], -1),
            torch.stack([yz, xx, axy, azx], -1),
            torch.stack([zx, axy, yy, ayz], -1),
            torch.stack([xy, azx, ayz, zz], -1),
        ],
        dim=-2,
    )
    best = squares.argmax(-1)[..., None, None].expand(*squares.shape[:-1], 1, 4)
    chosen = candidates.gather(-2, best).squeeze(-2)
    return _standardize(F.normalize(chosen, dim=-1))


def matrix_from_axis_angle(axis_angle: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3 3"]:
    """Rotation by the vector's length about its direction; smooth through zero."""
    return matrix_from_quaternion(quaternion_from_axis_angle(axis_angle))


def quaternion_from_axis_angle(axis_angle: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 4"]:
    """Unit quaternion of a rotation vector; smooth through zero."""
    half = axis_angle.square().sum(-1, keepdim=True).clamp_min(1e-24).sqrt() / 2
    return torch.cat([half.cos(), axis_angle * (half.sin() / (2 * half))], -1)


def _standardize(quaternion: Float[Tensor, "*n 4"]) -> Float[Tensor, "*n 4"]:
    """The same rotation with w >= 0."""
    return torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
