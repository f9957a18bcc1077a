"""What the stages behind the decoder work on: rotations and root of many sessions as numpy arrays, components first.

Lanes are ordered joint, frame, row, so that a frame or a stretch of frames is contiguous for all sessions.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

Array = np.ndarray


@dataclass
class PoseLanes:
    """Frames of several sessions; stages change it in place, one after the other."""

    turns: Float[Array, "4 j t b"]  # parent-relative unit quaternions `wxyz`, of either sign
    root: Float[
        Array, "3 t b"
    ]  # metres; before `Ground`: metres per frame along x, height, metres per frame along z
    fps: float

    def flat(self) -> Float[Array, "4 j n"]:
        """The rotations with frames and rows in one axis, as a view."""
        return self.turns.reshape(*self.turns.shape[:2], -1)


class Legs(NamedTuple):
    """Where the legs are, as forward kinematics of a chunk found them."""

    frames: Float[Array, "3 4 c n"]  # of every joint of the chains in the root's frame; n is frames x rows
    hips: Float[Array, "3 3 n"]  # world rotation of the root
    points: Float[
        Array, "3 p t b"
    ]  # ankles and toes (`feet` of the rig) from the root, along the world's axes


def keep(memory: Tensor, value: Float[Array, "b ..."], active: Bool[Array, " b"] | None) -> None:
    """Write a stage's memory, rows first; only in the active rows, in all for None."""
    if active is None:
        memory.numpy()[...] = value
    else:
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
