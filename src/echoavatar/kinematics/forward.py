"""Forward kinematics, batched, differentiable and vectorised by tree depth (paper, appendix Forward Kinematics).

Departs from the paper's formula in one point: the root's position is the given world position, not its constant
rest offset, so that travel through the room is part of the result. Pass zeros plus the rest offset to get theirs.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from .skeleton import Skeleton


class Pose(NamedTuple):
    """World rotation matrices and positions of every joint."""

    rotations: Float[Tensor, "*n j 3 3"]
    positions: Float[Tensor, "*n j 3"]


def forward_kinematics(
    skeleton: Skeleton, rotations: Float[Tensor, "*n j 3 3"], root: Float[Tensor, "*n 3"]
) -> Pose:
    """World pose from parent-relative rotations and the root's world position (metres)."""
    offsets = skeleton.offsets.to(rotations)
    world = [rotations[..., 0, :, :]]
    place = [root]
    order = [0]
    for level in skeleton.levels[1:]:
        joints = list(level)
        above = torch.tensor([order.index(skeleton.parents[j]) for j in joints], device=rotations.device)
        parent_rotation = torch.stack(world, -3).index_select(-3, above)
        parent_place = torch.stack(place, -2).index_select(-2, above)
        turned = parent_rotation @ rotations[..., joints, :, :]
        moved = parent_place + (parent_rotation @ offsets[joints, :, None]).squeeze(-1)
        world += list(turned.unbind(-3))
        place += list(moved.unbind(-2))
        order += joints
    back = [order.index(j) for j in range(skeleton.joints)]
    return Pose(torch.stack([world[i] for i in back], -3), torch.stack([place[i] for i in back], -2))
