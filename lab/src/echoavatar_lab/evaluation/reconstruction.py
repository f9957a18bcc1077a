"""How well the tokenizer reconstructs motion (paper, Table 1): MPJPE, root velocity error, codebook use.

MPJPE is character-centric (`metrics.position_error`), so only the pose counts; fingers are measured from the wrist.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from echoavatar.motion.kinematics import Skeleton, forward_kinematics

from .metrics.position_error import mean_joint_error, trans_loss, without_heading


class Reconstruction(NamedTuple):
    """Errors of one or several clips, averaged over frames and joints."""

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
        mean_joint_error(guess[:, body], truth[:, body]) * 1000,
        mean_joint_error(finger_guess, finger_truth) * 1000,
        trans_loss(rebuilt_velocity, velocity) * 1000,
    )


def codebook_use(codes: Int[Tensor, "n p q"], size: int) -> Float[Tensor, "p q"]:
    """Share of each codebook's entries that occur."""
    parts, layers = codes.shape[1:]
    return torch.tensor([[len(torch.unique(codes[:, p, q])) / size for q in range(layers)] for p in range(parts)])


def _centred(skeleton: Skeleton, rotations: Float[Tensor, "t j 3 3"]) -> Float[Tensor, "t j 3"]:
    facing = without_heading(rotations)
    return forward_kinematics(skeleton, facing, torch.zeros(len(rotations), 3)).positions


def _wrist(skeleton: Skeleton, joint: int, hands: set[int]) -> int:
    while joint in hands:
        joint = skeleton.parents[joint]
    return joint
