"""Mirror motion across the plane x = 0, to augment training data.

With M = diag(-1, 1, 1), the mirrored rotation of a joint is M R M of the joint on the other side. The rest offsets of
the rig must be symmetric too (`is_symmetric`).
"""

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.motion.kinematics.skeleton import Skeleton


def mirror_rotations(skeleton: Skeleton, rotations: Float[Tensor, "*n j 3 3"]) -> Float[Tensor, "*n j 3 3"]:
    """Parent-relative matrices of the mirrored pose."""
    flip = rotations.new_tensor([-1.0, 1.0, 1.0])
    return rotations[..., _pairs(skeleton), :, :] * flip[:, None] * flip


def mirror_quaternions(skeleton: Skeleton, quaternions: Float[Tensor, "*n j 4"]) -> Float[Tensor, "*n j 4"]:
    """Parent-relative quaternions `wxyz` of the mirrored pose."""
    return quaternions[..., _pairs(skeleton), :] * quaternions.new_tensor([1.0, 1.0, -1.0, -1.0])


def mirror_positions(positions: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """Mirrored world positions, for example of the root."""
    return positions * positions.new_tensor([-1.0, 1.0, 1.0])


def mirror_features(skeleton: Skeleton, features: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
    """Motion features (Y up) of the mirrored clip. Only signs and places change, so this is exact."""
    joints, pairs = list(skeleton.feature_joints), _pairs(skeleton)
    if any(pairs[joint] not in joints for joint in joints):
        raise ValueError("a joint and its mirror image must both belong to a body part")
    travel = travel_slice(skeleton)
    six = torch.cat([features[..., : travel.start], features[..., travel.stop :]], -1)
    source = [joints.index(pairs[joint]) for joint in joints]
    six = six.reshape(*six.shape[:-1], len(joints), 6)[..., source, :] * six.new_tensor([1, -1, -1, -1, 1, 1])
    moved = features[..., travel] * features.new_tensor([-1.0, 1.0, 1.0])
    six = six.flatten(-2)
    return torch.cat([six[..., : travel.start], moved, six[..., travel.start :]], -1)


def is_symmetric(skeleton: Skeleton, tolerance: float = 1e-4) -> bool:
    """Whether the rest offsets of every mirror pair are reflections of each other (metres)."""
    return bool((skeleton.offsets[_pairs(skeleton)] - mirror_positions(skeleton.offsets)).abs().max() <= tolerance)


def _pairs(skeleton: Skeleton) -> list[int]:
    if len(skeleton.config.mirror) != skeleton.joints:
        raise ValueError("the skeleton has no mirror pairs, so left and right cannot be swapped")
    return list(skeleton.config.mirror)
