"""Feet on the floor: the root travels so that the planted foot stays where it is.

The decoded root velocity carries the tokenizer's quantisation error, which shows as sliding feet. While a foot is
planted the legs already say how the pelvis moves over it, so we integrate that instead and fall back to the decoded
velocity as the feet leave the floor. Not in the paper; its foot losses (appendix) act in training only.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..kinematics import Skeleton, forward_kinematics
from ..nn import StreamState, write_rows

RELEASE_HEIGHT = 0.035  # metres above its rest height at which a point no longer counts as planted
SHARPNESS = 4.0  # how strongly the more firmly planted point leads


@dataclass
class GroundState(StreamState):
    """Where the root is, and where the contact points were relative to it in the last frame."""

    root: Float[Tensor, "b 2"]
    points: Float[Tensor, "b p 3"]
    weights: Float[Tensor, "b p"]
    seen: Bool[Tensor, " b"]


class Ground:
    """Integrates the root over planted feet, streaming; `forward` is one step from a fresh state."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.legs = leg_chain(skeleton)
        self.points = [self.legs.names.index(skeleton.names[j]) for j in skeleton.config.feet]
        rest = skeleton.rest_positions[list(skeleton.config.feet), 1]
        self.rest = rest - skeleton.rest_positions[:, 1].min() + _sole(skeleton)
        self.joints = skeleton.indices(self.legs.names)

    def init_state(self, rows: int) -> GroundState:
        """Standing at the origin, nothing seen yet."""
        n = len(self.points)
        return GroundState(
            torch.zeros(rows, 2),
            torch.zeros(rows, n, 3),
            torch.zeros(rows, n),
            torch.zeros(rows, dtype=torch.bool),
        )

    def step(
        self,
        rotations: Float[Tensor, "b t j 3 3"],
        travel: Float[Tensor, "b t 3"],
        state: GroundState,
        active: Bool[Tensor, " b"],
    ) -> Float[Tensor, "b t 3"]:
        """World position of the root, metres, from rotations and [vx, vz (metres per frame), height]."""
        hips = torch.zeros_like(travel)
        relative = forward_kinematics(self.legs, rotations[:, :, self.joints], hips).positions[
            :, :, self.points
        ]
        clearance = relative[..., 1] + travel[..., 2:] - self.rest
        weights = 1 - _smoothstep(clearance / RELEASE_HEIGHT)
        before = torch.cat(
            [torch.where(state.seen[:, None, None], state.points, relative[:, 0])[:, None], relative], 1
        )
        firm = torch.cat(
            [torch.where(state.seen[:, None], state.weights, weights[:, 0])[:, None], weights], 1
        )
        both = torch.minimum(firm[:, 1:], firm[:, :-1])
        share = both**SHARPNESS / (both**SHARPNESS).sum(-1, keepdim=True).clamp_min(1e-6)
        held = -(share[..., None] * (before[:, 1:] - before[:, :-1])[..., [0, 2]]).sum(-2)
        trust = both.amax(-1, keepdim=True)
        moved = trust * held + (1 - trust) * travel[..., :2]
        moved[:, 0] = torch.where(state.seen[:, None], moved[:, 0], torch.zeros_like(moved[:, 0]))
        place = state.root[:, None] + moved.cumsum(1)
        sinking = (weights**SHARPNESS * clearance).sum(-1) / (weights**SHARPNESS).sum(-1).clamp_min(1e-6)
        height = travel[..., 2] - weights.amax(-1) * sinking
        write_rows(state.root, place[:, -1], active)
        write_rows(state.points, relative[:, -1], active)
        write_rows(state.weights, weights[:, -1], active)
        write_rows(state.seen, torch.ones_like(state.seen), active)
        return torch.stack([place[..., 0], height, place[..., 1]], -1)


def leg_chain(skeleton: Skeleton) -> Skeleton:
    """The part of the skeleton between the root and the feet."""
    wanted: set[int] = set()
    for joint in skeleton.config.feet:
        while joint >= 0:
            wanted.add(joint)
            joint = skeleton.parents[joint]
    chain = sorted(wanted)
    config = skeleton.config.model_copy(
        update={
            "names": tuple(skeleton.names[j] for j in chain),
            "parents": tuple(
                -1 if skeleton.parents[j] < 0 else chain.index(skeleton.parents[j]) for j in chain
            ),
            "offsets": tuple(skeleton.config.offsets[j] for j in chain),
            "parts": {},
            "mirror": (),
            "feet": (),
            "vrm": {},
        }
    )
    return Skeleton(config)


def _sole(skeleton: Skeleton) -> float:
    """Height of the lowest joint above the floor in the rest pose."""
    return float(skeleton.rest_positions[:, 1].min())


def _smoothstep(x: Tensor) -> Tensor:
    x = x.clamp(0, 1)
    return x * x * (3 - 2 * x)
