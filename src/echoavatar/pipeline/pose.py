"""What the stages behind the decoder work on: a chunk of many sessions, the frames of each joint side by side.

Compiled loops take a session's eight frames at once (`nn.octet`). A chunk may have fewer; what then stands in the rest
of the eight is finite and means nothing.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from ..nn.octet import LANES

Array = np.ndarray


@dataclass
class PoseLanes:
    """Frames of several sessions; stages change it in place, one after the other."""

    turns: Float[Array, "b j 4 8"]  # parent-relative unit quaternions `wxyz`, of either sign
    root: Float[
        Array, "b 3 8"
    ]  # metres; before `Ground`: metres per frame along x, height, metres per frame along z
    fps: float
    frames: int = LANES

    def by_frame(self) -> Float[Array, "4 j t b"]:
        """A view of the rotations, components first."""
        return self.turns.transpose(2, 1, 3, 0)[:, :, : self.frames]

    def path(self) -> Float[Array, "3 t b"]:
        """A view of the root, components first."""
        return self.root.transpose(1, 2, 0)[:, : self.frames]


def keep(memory: Tensor, value: Float[Array, "b ..."], active: Bool[Array, " b"]) -> None:
    """Write a stage's memory, rows first, in the active rows."""
    np.copyto(memory.numpy(), value, where=active.reshape(-1, *([1] * (value.ndim - 1))))


def with_past(
    now: Float[Array, "*c t b"], past: Float[Array, "*c b"], is_new: Bool[Array, " b"] | None
) -> Float[Array, "*c u b"]:
    """A frame more: the last of the chunk before; in new rows (None: there is none) the first of this one again."""
    joined = np.empty((*now.shape[:-2], now.shape[-2] + 1, now.shape[-1]), np.float32)
    joined[..., 1:, :], joined[..., 0, :] = now, past
    if is_new is not None:
        joined[..., 0, is_new] = now[..., 0, is_new]
    return joined


def new_rows(seen: Float[Array, " b"]) -> Bool[Array, " b"] | None:
    """Rows in which nothing was seen yet, None when there are none."""
    is_new: Array = seen == 0
    return is_new if is_new.any() else None
