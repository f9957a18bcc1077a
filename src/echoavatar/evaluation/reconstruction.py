"""How well the tokenizer keeps motion (paper, Table 1): MPJPE, root velocity error, codebook use.

MPJPE is character-centric: root position and heading are those of the truth for both, so only the pose counts.
The paper does not say how it removes heading; ours aligns the hips' yaw. Fingers are measured relative to the wrist.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ..kinematics import Skeleton, forward_kinematics


class Reconstruction(NamedTuple):
    """Errors of one or many clips, averaged over frames and joints."""

    mpjpe_body_mm: float
    mpjpe_hands_mm: float
    root_velocity_mm: float  # mean length of the per-frame planar velocity error


def reconstruction(
    skeleton: Skeleton,
    rotations: Float[Tensor, "t j 3 3"],
    rebuilt: Float[Tensor, "t j 3 3"],
    velocity: Float[Tensor, "t 2"],
    rebuilt_velocity: Float[Tensor, "t 2"],
) -> Reconstruction:
    """Compare decoded motion with the truth."""
    parts = skeleton.config.parts
    body = [*parts["lower"], *parts["upper"]]
    truth = _centred(skeleton, rotations)
    guess = _centred(skeleton, rebuilt)
    hands = list(parts["hands"])
    anchors = [_wrist(skeleton, j, set(hands)) for j in hands]
    finger_truth, finger_guess = truth[:, hands] - truth[:, anchors], guess[:, hands] - guess[:, anchors]
    return Reconstruction(
        float((truth[:, body] - guess[:, body]).norm(dim=-1).mean() * 1000),
        float((finger_truth - finger_guess).norm(dim=-1).mean() * 1000),
        float((velocity - rebuilt_velocity).norm(dim=-1).mean() * 1000),
    )


def codebook_use(codes: Int[Tensor, "n p q"], size: int) -> Float[Tensor, "p q"]:
    """Share of each codebook's entries that occur."""
    parts, layers = codes.shape[1:]
    return torch.tensor(
        [[len(torch.unique(codes[:, p, q])) / size for q in range(layers)] for p in range(parts)]
    )


def _centred(skeleton: Skeleton, rotations: Float[Tensor, "t j 3 3"]) -> Float[Tensor, "t j 3"]:
    forward = rotations[:, 0, :, 2]
    yaw = torch.atan2(forward[:, 0], forward[:, 2])
    zero, one = torch.zeros_like(yaw), torch.ones_like(yaw)
    turn = torch.stack([yaw.cos(), zero, -yaw.sin(), zero, one, zero, yaw.sin(), zero, yaw.cos()], -1).view(
        -1, 3, 3
    )
    facing = rotations.clone()
    facing[:, 0] = turn @ rotations[:, 0]
    return forward_kinematics(skeleton, facing, torch.zeros(len(rotations), 3)).positions


def _wrist(skeleton: Skeleton, joint: int, hands: set[int]) -> int:
    while joint in hands:
        joint = skeleton.parents[joint]
    return joint
