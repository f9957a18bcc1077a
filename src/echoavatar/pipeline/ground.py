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

from ..kinematics import Skeleton
from ..nn import StreamState
from .pose import Array, PoseLanes, keep, new_rows, with_past

RELEASE_HEIGHT = 0.035  # metres above its rest height at which a point no longer counts as planted
_LEAST = 1e-6


@dataclass
class GroundState(StreamState):
    """Per row: seen (0 or 1), the root's place (2), and of the last frame each point's place (3) and weight."""

    memory: Float[Tensor, "b m"]


class Ground:
    """Integrates the root over planted feet, streaming; a rig whose feet are not known travels as decoded."""

    def __init__(self, skeleton: Skeleton, *, is_holding: bool = True) -> None:
        """Not holding, the root travels as decoded, whatever the feet do."""
        feet = list(skeleton.config.feet) if is_holding else []
        self._points = len(feet)
        rest = skeleton.rest_positions.numpy()
        self.rest = rest[feet, 1][:, None, None].astype(np.float32)  # the sole is at 0

    def init_state(self, rows: int) -> GroundState:
        """Standing at the origin, nothing seen yet."""
        return GroundState(torch.zeros(rows, 3 + 4 * self._points))

    def step(
        self,
        pose: PoseLanes,
        points: Float[Array, "3 p t b"],
        state: GroundState,
        active: Bool[Array, " b"] | None = None,
    ) -> None:
        """Turn the decoded travel of `pose.root` into world positions.

        `points` are ankles and toes (`skeleton.config.feet`) relative to the root, along the world's axes.
        """
        travel, memory = pose.root, state.memory.numpy().T
        is_new, after = new_rows(memory[0]), np.empty_like(memory)
        moved = travel[::2].copy()
        if self._points:
            past = memory[3:].reshape(4, self._points, -1)
            here = np.empty((4, *points.shape[1:]), np.float32)
            here[:3] = points
            clearance = points[1] + (travel[1] - self.rest)
            share = np.minimum(np.maximum(clearance * (1 / RELEASE_HEIGHT), 0), 1)
            weights = np.subtract(1, share * share * (3 - 2 * share), out=here[3])
            _hold(moved, with_past(here, past, is_new))
            sharp = np.square(np.square(weights))
            sinking = np.add.reduce(sharp * clearance) / np.maximum(np.add.reduce(sharp), _LEAST)
            travel[1] -= np.maximum.reduce(weights) * sinking
            after[3:] = here[:, :, -1].reshape(-1, here.shape[-1])
        if is_new is not None:
            moved[:, 0, is_new] = 0
        moved[:, 0] += memory[1:3]
        np.cumsum(moved, axis=1, out=travel[::2])
        after[0], after[1:3] = 1, travel[::2, -1]
        keep(state.memory, after.T, active)


def _hold(moved: Float[Array, "2 t b"], path: Float[Array, "4 p u b"]) -> None:
    """Horizontal way of the root from frame to frame, in place: against that of its planted points."""
    both = np.minimum(path[3, :, 1:], path[3, :, :-1])
    share = np.square(np.square(both))  # the more firmly planted point leads
    share /= np.maximum(np.add.reduce(share), _LEAST)
    across = path[:3:2]
    held = np.add.reduce(share * (across[:, :, :-1] - across[:, :, 1:]), axis=1)
    held -= moved
    held *= np.maximum.reduce(both)
    moved += held
