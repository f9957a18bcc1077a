"""The paper's own rule (Online Post-Processing): a cylinder around the spine, a remap of distance, a shoulder swing.

Kept for comparison and for rigs that were tuned with it; `HandCollisions` is the default and says what it does better.
Written in torch, so it can be differentiated through.

A wrist at horizontal distance d from the pelvis' vertical axis, where the cylinder has radius r, is moved along its
own half-plane to d + r (1 - s(d / (1.5 r))), s the smoothstep: 0 goes to r, 1.5 r stays. The arm then turns about
the shoulder by the least rotation that points it there, so the hand gets the direction and not the distance.
"""

from itertools import pairwise

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from echoavatar.config import Config

from ..kinematics import Skeleton, forward_kinematics


class SwingConfig(Config):
    """A cylinder whose radius changes with height, in the unit of the rig."""

    profile: tuple[tuple[float, float], ...] = Field(
        min_length=2, description="(height above the pelvis, radius), from below; flat beyond the ends"
    )
    reach: float = Field(1.5, gt=1, description="radii at which the rule begins to act")
    up: int = Field(1, ge=0, le=2, description="axis of the pelvis that points up")
    snap: float = Field(0.0, ge=0, description="1 - cosine below which a swing is left out (reference: 1e-6)")


def remapped_distance(
    distance: Float[Tensor, "*n"], radius: Float[Tensor, "*n"], reach: float = 1.5
) -> Float[Tensor, "*n"]:
    """Distance from the axis after the rule: [0, reach radius] onto [radius, reach radius], beyond unchanged."""
    share = (distance / (reach * radius)).clamp(0, 1)
    return distance + radius * (1 - share.square() * (3 - 2 * share))


def radius_at(height: Float[Tensor, "*n"], config: SwingConfig) -> Float[Tensor, "*n"]:
    """Radius of the cylinder, linear between the profile's points."""
    radius = torch.full_like(height, config.profile[0][1])
    for (low, first), (high, second) in pairwise(config.profile):
        radius = radius + (second - first) * ((height - low) / (high - low)).clamp(0, 1)
    return radius


def swing_between(
    start: Float[Tensor, "*n 3"], end: Float[Tensor, "*n 3"], snap: float = 0.0
) -> Float[Tensor, "*n 3 3"]:
    """The least rotation that points `start` along `end`; opposite vectors turn by half about any axis across."""
    a, b = torch.nn.functional.normalize(start, dim=-1), torch.nn.functional.normalize(end, dim=-1)
    cosine = (a * b).sum(-1)[..., None, None]
    axis = torch.linalg.cross(a, b)
    skew = torch.linalg.cross(axis[..., None, :], -torch.eye(3).to(a).expand(*a.shape, 3))
    one = torch.eye(3).to(a)
    turn = one + skew + skew @ skew / (1 + cosine).clamp_min(1e-6)
    across = torch.linalg.cross(a, one[a.abs().argmin(-1)])
    across = torch.nn.functional.normalize(across, dim=-1)
    half = 2 * across[..., :, None] * across[..., None, :] - one
    turn = torch.where(cosine < -1 + 1e-6, half, turn)
    return torch.where(cosine > 1 - snap, one, turn) if snap else turn


def swing_clear(
    skeleton: Skeleton,
    rotations: Float[Tensor, "*n j 3 3"],
    config: SwingConfig,
    arms: tuple[tuple[int, int], ...],
) -> Float[Tensor, "*n j 3 3"]:
    """Parent-relative rotations with each arm swung clear; `arms` are (upper arm joint, wrist joint) pairs.

    A wrist exactly on the axis has no half-plane and stays where it is.
    """
    pelvis = torch.zeros_like(rotations[..., 0, :, 0])
    upright = torch.cat([torch.eye(3).to(rotations).expand_as(rotations[..., :1, :, :]), rotations[..., 1:, :, :]], -3)
    pose = forward_kinematics(skeleton, upright, pelvis)
    changed = rotations.clone()
    for shoulder, wrist in arms:
        hand = pose.positions[..., wrist, :]
        flat = hand * (torch.arange(3, device=hand.device) != config.up)
        distance = flat.norm(dim=-1)
        radius = radius_at(hand[..., config.up], config)
        further = remapped_distance(distance, radius, config.reach) / (distance + 1e-9)
        target = hand + flat * (further - 1)[..., None]
        origin = pose.positions[..., shoulder, :]
        swing = swing_between(hand - origin, target - origin, config.snap)
        above = pose.rotations[..., skeleton.parents[shoulder], :, :]
        new = above.mT @ swing @ pose.rotations[..., shoulder, :, :]
        is_near = (distance < config.reach * radius)[..., None, None]
        changed[..., shoulder, :, :] = torch.where(is_near, new, rotations[..., shoulder, :, :])
    return changed
