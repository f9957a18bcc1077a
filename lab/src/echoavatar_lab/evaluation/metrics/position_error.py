"""MPJPE and Trans loss: errors of a reconstruction frame by frame (paper, table on the tokenizer).

- MPJPE: mean distance of corresponding joints. The paper calls it "character-centric" without a definition; ours puts
  both roots at the origin and turns both bodies so that the hips face +Z (`without_heading`).
- Trans loss: mean over frames of |v_made - v_true| of the root's planar steps. The paper does not name the norm: L2 by
  default, L1 as an option.

Metres; the paper prints both in 1e-4 m (its 184.1 is 18.41 mm). A mean over joints depends on the choice of joints:
fingers are many, and their errors, measured from the wrist, are small.
"""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

PAPER_UNIT_M = 1e-4


def heading(root_rotations: Float[Tensor, "t 3 3"]) -> Float[Tensor, " t"]:
    """Yaw of the hips in radians: the direction of their forward axis on the ground."""
    forward = root_rotations[..., :, 2]
    return torch.atan2(forward[..., 0], forward[..., 2])


def turn_about_up(yaw: Float[Tensor, " t"]) -> Float[Tensor, "t 3 3"]:
    """Rotation that turns a body facing `yaw` back to +Z."""
    zero, one = torch.zeros_like(yaw), torch.ones_like(yaw)
    rows = [yaw.cos(), zero, -yaw.sin(), zero, one, zero, yaw.sin(), zero, yaw.cos()]
    return torch.stack(rows, -1).view(-1, 3, 3)


def without_heading(rotations: Float[Tensor, "t j 3 3"]) -> Float[Tensor, "t j 3 3"]:
    """The same pose with the hips facing +Z; the root is joint 0."""
    facing = rotations.clone()
    facing[:, 0] = turn_about_up(heading(rotations[:, 0])) @ rotations[:, 0]
    return facing


def mean_joint_error(made: Float[Tensor, "t j 3"], true: Float[Tensor, "t j 3"]) -> float:
    """Mean distance of corresponding joints, metres."""
    return float((true - made).norm(dim=-1).mean())


def trans_loss(made: Float[Tensor, "t 2"], true: Float[Tensor, "t 2"], norm: Literal["l1", "l2"] = "l2") -> float:
    """Mean length of the error of the root's planar steps, metres a frame."""
    return float((true - made).norm(dim=-1, p=1 if norm == "l1" else 2).mean())
