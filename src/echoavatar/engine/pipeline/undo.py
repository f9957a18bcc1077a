"""Undoing steps of the model: the values that a step overwrote in one row of the state.

A step writes about a tenth of a row, so only the overwritten values are kept. Undoing the last n steps, latest first,
restores the state of n steps ago to the bit.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int, Shaped

from echoavatar.nn import StreamState

SMALL = 4096  # elements; a smaller array is kept whole


class Patch(NamedTuple):
    """Overwritten values of one array's row: all of it, or those at `where` of the flattened row."""

    where: Int[np.ndarray, " n"] | None
    values: Any  # a GPU's row is a tensor


def changes(before: list[Any], state: StreamState, row: int) -> list[Patch]:
    """The values that a step overwrote in a row; `before` is the state's `snapshot` from before the step."""
    one = slice(row, row + 1)
    return [_patch(old[one], new[one]) for old, new in zip(before, state.arrays(), strict=True)]


def undo(patches: list[Patch], state: StreamState, row: int) -> None:
    """Restore the row to what it was before the step that made these patches."""
    for part, (where, values) in zip(state.arrays(), patches, strict=True):
        if where is None:
            part[row : row + 1] = values
        else:
            _flat(part[row])[where] = values


def _patch(old: Any, new: Any) -> Patch:
    if not isinstance(new, np.ndarray):  # a GPU has room, and looking for what changed would make it wait
        return Patch(None, old.clone())
    if old.size >= SMALL:
        where = np.flatnonzero(_bits(old) != _bits(new))
        if 2 * len(where) < old.size:
            return Patch(where, _flat(old)[where])
    return Patch(None, old.copy())


def _flat(values: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, " n"]:
    """A view; ValueError if there is none."""
    return values.reshape(-1, copy=False)


def _bits(values: Shaped[np.ndarray, "..."]) -> Int[np.ndarray, " n"]:
    """The values' bit patterns as integers, which tell -0.0 from 0.0 and compare NaN."""
    return _flat(values).view(f"i{values.itemsize}")
