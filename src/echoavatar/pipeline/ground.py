"""Feet on the floor: the root travels so that the planted foot stays where it is.

The decoded root velocity carries the tokenizer's quantisation error, which shows as sliding feet. While a foot is
planted the legs already say how the pelvis moves over it, so we integrate that instead and fall back to the decoded
velocity as the feet leave the floor. Not in the paper; its foot losses (appendix) act in training only.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..ik.chains import Chains
from ..kinematics import Skeleton
from ..kinematics.octets import matrix, place_at, quaternion_at, turned
from ..nn import StreamState
from ..nn.compiled import ONE, ZERO, F
from ..nn.octet import behind, exact, least, load, most, scratch, spread, store
from .pose import Array, PoseLanes

RELEASE_HEIGHT = 0.035  # metres above its rest height at which a point no longer counts as planted
_LEAST = F(1e-6)
_PER_HEIGHT = F(1 / RELEASE_HEIGHT)


@dataclass
class GroundState(StreamState):
    """Per row: seen (0 or 1), the root's place (2), and of the last frame each point's place (3) and weight."""

    memory: Float[Tensor, "b m"]


class Ground:
    """Integrates the root over planted feet, streaming; a rig whose feet are not known travels as decoded."""

    def __init__(self, skeleton: Skeleton, chains: Chains, *, is_holding: bool = True) -> None:
        """`chains` must hold `skeleton.config.feet`. Not holding, the root travels as decoded, whatever they do."""
        feet = list(skeleton.config.feet) if is_holding else []
        self.slots = np.array([chains.slot[joint] for joint in feet], np.int64)
        rest = skeleton.rest_positions.numpy()
        self.rest = rest[feet, 1].astype(np.float32)  # the sole is at 0

    def init_state(self, rows: int) -> GroundState:
        """Standing at the origin, nothing seen yet."""
        return GroundState(torch.zeros(rows, 3 + 4 * len(self.slots)))

    def step(
        self, pose: PoseLanes, frames: Float[Array, "b c 12 8"], state: GroundState, active: Bool[Array, " b"]
    ) -> None:
        """Turn the decoded travel of `pose.root` into world positions; `frames` are those of the pose in the chains."""
        travel(
            self.slots, self.rest, frames, pose.turns, pose.root, pose.frames, state.memory.numpy(), active
        )


@exact()
def travel(slots, rest, frames, turns, roots, count, memory, active):  # type: ignore[no-untyped-def]
    """All rows: ankles and toes relative to the root, along the world's axes, say how the root moves over them."""
    points = slots.shape[0]
    here = scratch((4, points, 8))
    for row in range(turns.shape[0]):
        is_new = memory[row, 0] == ZERO
        height = load(roots, (row, 1))
        zero = spread(ZERO, height)
        if points:
            hips = matrix(quaternion_at(turns, row, 0))
            held_x, held_z, total, strongest = zero, zero, zero, zero
            sinking, pressing, planted = zero, zero, zero
            for point in range(points):
                x, y, z = turned(hips, place_at(frames, row, slots[point]))
                clearance = height + y - rest[point]
                share = least(most(clearance * _PER_HEIGHT, ZERO), ONE)
                weight = ONE - share * share * (F(3) - F(2) * share)
                for k, number in enumerate((x, y, z, weight)):
                    store(here, (k, point), number)
                at = 3 + point
                last_x = here[0, point, 0] if is_new else memory[row, at]
                last_z = here[2, point, 0] if is_new else memory[row, at + 2 * points]
                last_weight = here[3, point, 0] if is_new else memory[row, at + 3 * points]
                both = least(weight, behind(weight, last_weight))
                lead = both * both * both * both  # the more firmly planted point leads
                held_x += lead * (behind(x, last_x) - x)
                held_z += lead * (behind(z, last_z) - z)
                total, strongest = total + lead, most(strongest, both)
                sharp = weight * weight * weight * weight
                sinking, pressing = sinking + sharp * clearance, pressing + sharp
                planted = most(planted, weight)
            x, z, total = load(roots, (row, 0)), load(roots, (row, 2)), most(total, _LEAST)
            store(roots, (row, 0), x + (held_x / total - x) * strongest)
            store(roots, (row, 2), z + (held_z / total - z) * strongest)
            store(roots, (row, 1), height - planted * (sinking / most(pressing, _LEAST)))
        for axis in (0, 2):
            place = memory[row, 1 + axis // 2]
            for frame in range(8):
                if frame or not is_new:
                    place += roots[row, axis, frame]
                roots[row, axis, frame] = place
        if active[row]:
            memory[row, 0] = ONE
            memory[row, 1], memory[row, 2] = roots[row, 0, count - 1], roots[row, 2, count - 1]
            for point in range(points):
                for k in range(4):
                    memory[row, 3 + k * points + point] = here[k, point, count - 1]
