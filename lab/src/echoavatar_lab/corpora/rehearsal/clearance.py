"""Collision avoidance: wrist targets move away where a hand or forearm would enter torso, head or the other hand.

Torso and head are an elliptic column and a ball in chest axes; points inside are pushed out by a smooth penalty.
"""

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..controls import Array, Controls, smoothed
from ..solver import arm_frames

TORSO_HALF_WIDTH, TORSO_HALF_DEPTH, TORSO_FRONT = 0.185, 0.150, 0.010  # metres, hand's thickness included
TORSO_TOP, TORSO_FADE = 0.20, 0.10
HEAD_CENTRE, HEAD_RADIUS = (0.0, 0.345, 0.035), 0.150
HANDS_APART = 0.080
ROUNDS = 3
BLOCK_FRAMES = 16_384
_SHOULDER = torch.tensor([0.030, 0.120, 0.005], dtype=torch.float64)
_CLAVICLE = torch.tensor([0.130, 0.010, -0.010], dtype=torch.float64)
_ALONG_HAND = (0.0, 0.085, 0.160)  # wrist, palm, fingertips
_MIRROR = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)


def keep_hands_clear(controls: Controls) -> Controls:
    """The same motion with hands and forearms outside the body and hands apart from each other."""
    wrist = controls.wrist.copy()
    for first in range(0, len(controls), BLOCK_FRAMES):
        block = slice(first, first + BLOCK_FRAMES)
        for _ in range(ROUNDS):
            wrist[block] += _correction(replace(controls[block], wrist=wrist[block]))
    return replace(controls, wrist=controls.wrist + smoothed(wrist - controls.wrist, 0.05))


def _correction(controls: Controls) -> Array:
    """Displacement of each wrist, (t, 2, 3)."""
    points = [_points(controls, side) for side in range(2)]
    moves = [_out_of_body(p) for p in points]
    left, right = points[0][:, 1], points[1][:, 1] * _MIRROR
    gap = left - right + torch.tensor([1e-4, 0.0, 0.0], dtype=torch.float64)
    distance = gap.norm(dim=-1, keepdim=True)
    apart = gap / distance * 0.5 * _short(distance, HANDS_APART, 0.010)
    both = [moves[0] + apart, moves[1] - apart * _MIRROR]
    return torch.stack(both, dim=1).float().numpy()


def _points(controls: Controls, side: int) -> Tensor:
    """Wrist, palm, fingertips and mid-forearm in mirrored chest axes, (t, 4, 3)."""
    arm = arm_frames(controls, side)
    shoulder = _SHOULDER + arm.clavicle @ _CLAVICLE
    wrist = shoulder + arm.wrist
    way = (arm.lower @ arm.half_turn @ arm.hand)[..., 0]
    forearm = shoulder + 0.4 * arm.elbow + 0.6 * arm.wrist
    return torch.stack([*(wrist + far * way for far in _ALONG_HAND), forearm], dim=1)


def _out_of_body(points: Tensor) -> Tensor:
    """Mean displacement that brings the inside points out, weighted by depth, (t, 3)."""
    x, y, z = points.unbind(-1)
    across, ahead = x / TORSO_HALF_WIDTH, (z - TORSO_FRONT) / TORSO_HALF_DEPTH
    scale = (across.square() + ahead.square()).clamp_min(1e-4).sqrt()
    below = ((TORSO_TOP - y) / TORSO_FADE).clamp(0, 1)
    share = below.square() * (3 - 2 * below) * _short(scale, 1.0, 0.03) / scale
    torso = torch.stack([share * x, torch.zeros_like(x), share * (z - TORSO_FRONT)], dim=-1)
    away = points - torch.tensor(HEAD_CENTRE, dtype=torch.float64)
    distance = away.norm(dim=-1, keepdim=True).clamp_min(1e-3)
    ways = torso + away / distance * _short(distance, HEAD_RADIUS, 0.008)
    depth = ways.norm(dim=-1, keepdim=True) + 1e-6
    mean: Tensor = (ways * depth).sum(dim=1) / depth.sum(dim=1)
    return mean


def _short(value: Tensor, least: float, width: float) -> Tensor:
    """Smooth version of max(least - value, 0)."""
    lack: Tensor = width * F.softplus((least - value) / width)
    return lack
