"""Undoing steps of the model: the values that a step overwrote in one row of the state.

A step writes about a tenth of a row, so only the overwritten values are kept. Undoing the last n steps, latest first,
restores the state of n steps ago to the bit.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Int, Shaped
from torch import Tensor

from echoavatar.nn import StreamState

_WORDS = {1: torch.uint8, 2: torch.int16, 4: torch.int32, 8: torch.int64}  # by size in bytes
SMALL = 4096  # elements; a smaller tensor is kept whole


class Patch(NamedTuple):
    """Overwritten values of one tensor's row: all of it, or those at `where` of the flattened row."""

    where: Int[Tensor, " n"] | None
    values: Shaped[Tensor, " n"]


def changes(before: list[Tensor], state: StreamState, row: int) -> list[Patch]:
    """The values that a step overwrote in a row; `before` is the state's `snapshot` from before the step."""
    pairs = zip(before, state.tensors(), strict=True)
    return [_patch(old[row : row + 1].reshape(-1), _row(new, row)) for old, new in pairs]


def undo(patches: list[Patch], state: StreamState, row: int) -> None:
    """Restore the row to what it was before the step that made these patches."""
    for tensor, patch in zip(state.tensors(), patches, strict=True):
        flat = _row(tensor, row)
        if patch.where is None:
            flat.copy_(patch.values)
        else:
            flat[patch.where] = patch.values


def _row(tensor: Tensor, row: int) -> Tensor:
    """The row, flat, as a view."""
    return tensor[row : row + 1].view(-1)


def _patch(old: Tensor, new: Tensor) -> Patch:
    if old.numel() < SMALL:
        return Patch(None, old.clone())
    different = _bits(old) != _bits(new)
    if old.device.type == "cpu":
        where = torch.from_numpy(np.flatnonzero(different.numpy()))  # torch's own nonzero takes twice as long
    else:
        where = different.nonzero().flatten()
    return Patch(where, old[where]) if 2 * len(where) < old.numel() else Patch(None, old.clone())


def _bits(values: Tensor) -> Int[Tensor, " n"]:
    """The values' bit patterns as integers, which tell -0.0 from 0.0 and compare NaN."""
    return values.view(_WORDS[values.element_size()])
