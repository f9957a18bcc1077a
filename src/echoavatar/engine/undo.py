"""Taking a step back: what one step changed in one row of a state, kept so that it can be undone exactly.

A row of the default bundle is 3.2 MB, of which a step writes a tenth; so the old values of what changed are kept, not
the row. Undoing the last n steps, latest first, gives the state of n steps ago to the bit.
"""

from typing import NamedTuple

import torch
from jaxtyping import Int, Shaped
from torch import Tensor

from ..nn import StreamState

SMALL = 4096  # numbers; a tensor of fewer is kept whole


class Patch(NamedTuple):
    """Old values of one tensor's row: all of them, or those at `where` of the flattened row."""

    where: Int[Tensor, " n"] | None
    values: Shaped[Tensor, " n"]


def changes(before: list[Tensor], state: StreamState, row: int) -> list[Patch]:
    """What a step changed in a row; `before` is the state's `snapshot` from before the step."""
    pairs = zip(before, state.tensors(), strict=True)
    return [_patch(old[row : row + 1].reshape(-1), _row(new, row)) for old, new in pairs]


def undo(patches: list[Patch], state: StreamState, row: int) -> None:
    """Put the row back to what it was before the step of these patches."""
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
    different = old != new
    if old.is_floating_point():
        different |= torch.signbit(old) != torch.signbit(new)
        different |= old.isnan() | new.isnan()
    where = different.nonzero().flatten()
    return Patch(where, old[where]) if 2 * len(where) < old.numel() else Patch(None, old.clone())
