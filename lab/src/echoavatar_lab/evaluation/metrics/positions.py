"""Scores of joint positions and rotations alone: reconstruction error, variety, smoothness, feet and floor.

- MPJPE: mean distance of corresponding joints. The paper calls it "character-centric" without a definition; ours puts
  both roots at the origin and turns both bodies so that the hips face +Z (`without_heading`), so only the pose counts.
  Fingers are many, and their errors, measured from the wrist, are small.
- Trans loss: mean over frames of |v_made - v_true| of the root's planar steps. The paper does not name the norm;
  ours is L2. The paper prints both in 1e-4 m (its 184.1 is 18.41 mm).
- L1 diversity (paper, appendix L1 Diversity; the best value is the truth's):
  Div = (1/N) sum over frames and joints of |p - mean of p over its clip|_1, root at the origin, metres. The sum runs
  over the three axes of all joints, so the value grows with their number: 55 joints of SMPL-X in the published tables,
  all joints of our rig here. Frames of all clips count equally (N is their total). The published code overwrites its
  input positions with |p - mean|; scripts that score beats afterwards score that instead of the motion.
- Physical plausibility: jerk, floor penetration, and EDGE's foot contact score. Sliding feet are measured by
  `data.faults.skate`, hands inside the body by `data.faults.penetration_depth_m`.

Names carry the units; without one it is metres.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics import Skeleton
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.kinematics import forward_kinematics

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


def mean_distance(made: Float[Tensor, "*n d"], true: Float[Tensor, "*n d"]) -> float:
    """Mean distance of corresponding points: MPJPE of joints, the trans loss of the root's planar steps."""
    return float((true - made).norm(dim=-1).mean())


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
    truth, guess = (centred(skeleton, turns) for turns in (rotations, rebuilt))
    hands = list(parts["hands"])
    anchors = [_wrist(skeleton, joint, set(hands)) for joint in hands]
    finger_truth, finger_guess = truth[:, hands] - truth[:, anchors], guess[:, hands] - guess[:, anchors]
    return Reconstruction(
        mean_distance(guess[:, body], truth[:, body]) * 1000,
        mean_distance(finger_guess, finger_truth) * 1000,
        mean_distance(rebuilt_velocity, velocity) * 1000,
    )


def centred(skeleton: Skeleton, rotations: Float[Tensor, "t j 3 3"]) -> Float[Tensor, "t j 3"]:
    """Joint positions, metres, with the root at the origin and the hips facing +Z."""
    facing = without_heading(rotations)
    return forward_kinematics(skeleton, facing, torch.zeros(len(rotations), 3)).positions


def _wrist(skeleton: Skeleton, joint: int, hands: set[int]) -> int:
    while joint in hands:
        joint = skeleton.parents[joint]
    return joint


def l1_deviation(positions: Float[np.ndarray, "t j 3"]) -> float:
    """Diversity of one clip in metres: mean over frames of the summed deviation from the clip's mean pose.

    Positions must be relative to the root. The diversity of several clips is their mean, weighted by length.
    """
    values = np.asarray(positions, np.float64)
    return float(np.abs(values - values.mean(0)).sum() / len(values))


EDGE_SCALE = 10_000.0


def jerk_m_s3(positions: Float[np.ndarray, "t j 3"]) -> float:
    """Mean length of the third derivative of joint positions relative to the root; NaN below four frames of 30 fps."""
    if len(positions) < 4:
        return float("nan")
    relative = positions - positions[:, :1]
    return float(np.linalg.norm(np.diff(relative, n=3, axis=0), axis=-1).mean() * FRAME_RATE_HZ**3)


def floor_depth_cm(feet: Float[np.ndarray, "t f 3"]) -> float:
    """Mean depth of the lowest foot point below the floor (Y up), centimetres; 0 in frames where it is above."""
    return float(np.maximum(-feet[..., 1].min(1), 0).mean() * 100)


def foot_contact_score(positions: Float[np.ndarray, "t j 3"], feet: Sequence[int], *, up: int = 1) -> float:
    """EDGE's physical foot contact score (PFC), times 10,000 as in its table; 0 is best.

    The root can only accelerate when a foot stands. The score is the mean over frames of the root's acceleration
    (downward part left out, scaled by the clip's maximum) times the horizontal step of each foot's stiller point.
    Known faults: it has no physical unit, one jolt rescales the whole clip, and a body that floats motionless scores 0.
    `feet` are left ankle and toe, right ankle and toe. EDGE has Z up at 30 fps: `up=2`.
    """
    positions = np.asarray(positions, np.float64)
    acceleration = np.diff(positions[:, 0], n=2, axis=0) * FRAME_RATE_HZ**2
    acceleration[:, up] = np.maximum(acceleration[:, up], 0)
    push = np.linalg.norm(acceleration, axis=-1)
    flat = [axis for axis in range(3) if axis != up]
    steps = np.linalg.norm(np.diff(positions[1:, list(feet)][..., flat], axis=0), axis=-1)
    stiller = steps.reshape(len(steps), 2, 2).min(-1)
    return float((stiller.prod(1) * push / max(push.max(), 1e-12)).mean() * EDGE_SCALE)
