"""Undoing steps of the model: the values that a step overwrote in one row of the state.

A step writes about a tenth of a row, so only the overwritten values are kept. Undoing the last n steps, latest first,
restores the state of n steps ago to the bit.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int, Shaped

from echoavatar.nn import StreamState

SMALL = 4096  # elements; a smaller array is kept whole


class Patch(NamedTuple):
    """Overwritten values of one array's row: all of it, or those at `where` of the flattened row."""

    where: Int[np.ndarray, " n"] | None
    values: Any  # a GPU's row is a tensor


def changes(pairs: Iterable[tuple[Any, Any]], before: int, after: int) -> list[Patch]:
    """The values that a step overwrote in a row: `pairs` are the arrays of the states before and after it.

    `before` and `after` are the row's numbers in them.
    """
    return [_patch(old[before : before + 1], new[after : after + 1]) for old, new in pairs]


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
