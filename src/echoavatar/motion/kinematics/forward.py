"""Forward kinematics in torch: batched, differentiable, one product per tree level (paper, appendix).

One departure from the paper's formula: the root's position is the given world position, not its constant rest offset,
so that the result includes the root's travel. `ik.chains` is the compiled version for the live stages.
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


def forward_kinematics(skeleton: Skeleton, rotations: Float[Tensor, "*n j 3 3"], root: Float[Tensor, "*n 3"]) -> Pose:
    """World pose from parent-relative rotations and the root's world position (metres)."""
    tables = skeleton.level_tables(rotations.device)
    local = torch.split(rotations.index_select(-3, tables.order), list(tables.sizes), -3)
    world, places = [local[0]], [root[..., None, :]]
    for level, parents, offsets in zip(local[1:], tables.parents, tables.offsets, strict=True):
        above = world[-1].index_select(-3, parents)
        places.append(places[-1].index_select(-2, parents) + (above @ offsets.to(above)).squeeze(-1))
        world.append(above @ level)
    return Pose(torch.cat(world, -3).index_select(-3, tables.back), torch.cat(places, -2).index_select(-2, tables.back))
