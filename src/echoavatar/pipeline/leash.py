"""The root kept near where it started, without sliding feet.

A character that dances for an hour must not leave the picture. Beyond `NEAR` of its leash the root is drawn back, and
the farther out, the less it moves outwards; it is never beyond. The feet do not notice: `feet` holds planted ones where
they stand and they find their new place with the next step. So the pull rests while a foot is already held `LEAN` from
where it was decoded, and goes on when that foot has stepped. Pinned rows (`in_place`) do not move at all. Streaming by
the chunk. Not in the paper.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..nn import StreamState
from .pose import Array, PoseLanes, keep, new_rows, with_past

NEAR, EDGE = 0.4, 0.7  # of the leash: from here on the root is drawn back; from here on it is slowed outwards
PULL_SPEED = 0.25  # metres per second at the leash's end
LEAN = 0.05  # metres a held foot may be off before the pull rests


@dataclass
class LeashState(StreamState):
    """Per row: seen, the root before and after the leash (2 + 2), the pull of the last frame (2), how much it slows."""

    memory: Float[Tensor, "b 8"]


class Leash:
    """Soft bound on the way of the root from the origin, where a session starts."""

    def init_state(self, rows: int) -> LeashState:
        """At the start."""
        return LeashState(torch.zeros(rows, 8))

    def step(
        self,
        pose: PoseLanes,
        state: LeashState,
        active: Bool[Array, " b"],
        *,
        radius: Float[Array, " b"],
        is_pinned: Bool[Array, " b"],
        lean: Float[Array, " b"],
    ) -> None:
        """Move `pose.root` in place. Rows with radius 0 are free; `lean` is how far off held feet are now, metres."""
        path = pose.path()
        raw = path[::2].copy()
        memory = state.memory.numpy().T
        is_new = new_rows(memory[0])
        ways = np.diff(with_past(raw, memory[1:3], is_new), axis=1)
        start = memory[3:5].copy()
        if is_new is not None:
            start[:, is_new] = raw[:, 0, is_new]
        is_held = radius > 0
        reach = np.where(is_held, radius, 1)
        far = np.hypot(start[0], start[1])
        out = start / np.maximum(far, 1e-6)
        rest = 1 - np.square(np.minimum(lean / LEAN, 1))
        pull = -out * (_ease((far / reach - NEAR) / (1 - NEAR)) * rest * is_held * (PULL_SPEED / pose.fps))
        slow = _ease((far / reach - EDGE) / (1 - EDGE)) * is_held
        share = ((np.arange(raw.shape[1], dtype=np.float32) + 1) / raw.shape[1])[:, None]
        outwards = np.maximum((ways * out[:, None]).sum(0), 0) * (memory[7] + share * (slow - memory[7]))
        ways += memory[5:7, None] + share * (pull - memory[5:7])[:, None] - out[:, None] * outwards
        place = start[:, None] + np.cumsum(ways, axis=1)
        beyond = np.hypot(place[0], place[1]) / reach
        place /= np.where(is_held, np.maximum(beyond, 1), 1)
        place = np.where(is_held, place, raw) * ~is_pinned
        last = np.concatenate([np.ones_like(far)[None], raw[:, -1], place[:, -1], pull, slow[None]])
        keep(state.memory, last.T, active)
        path[::2] = place


def _ease(share: Float[Array, " b"]) -> Float[Array, " b"]:
    share = np.minimum(np.maximum(share, 0), 1)
    eased: Array = share * share * (3 - 2 * share)
    return eased
