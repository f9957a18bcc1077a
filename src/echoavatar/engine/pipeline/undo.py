"""The rows of an engine's state, and how steps of the model are undone.

The arrays of a row are views of one block of words, so one comparison finds what a step overwrote. A step writes about
a tenth of a row, so only that is kept. Undoing the last n steps, latest first, restores the state of n steps ago to the
bit. On a GPU a row is kept whole: memory is ample there, and the comparison would make it wait.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from echoavatar.nn import StreamState


class Patch(NamedTuple):
    """Overwritten values of a row."""

    where: Int[np.ndarray, " n"] | slice  # places of the words in the row; a slice takes all
    words: Int[np.ndarray, " n"]
    tensors: list[Any]


class Rows:
    """The states of all rows, each stepped by one thread at a time."""

    def __init__(self, state: StreamState) -> None:
        """`state` is new, so its arrays are zero; they give the layout. Its tensors are taken over."""
        arrays = [part for part in state.arrays() if isinstance(part, np.ndarray)]
        ends = np.cumsum([-(-part[0].nbytes // 8) for part in arrays])
        self._words = np.zeros((len(arrays[0]), ends[-1]), np.int64)
        places = zip(np.split(self._words, ends[:-1], 1), arrays, strict=True)
        views = iter([own.view(it.dtype)[:, : it[0].size].reshape(it.shape, copy=False) for own, it in places])
        self.state = state.mapped(lambda part: next(views) if isinstance(part, np.ndarray) else part)
        self._tensors = [part for part in self.state.arrays() if not isinstance(part, np.ndarray)]
        self._views = [self.state.rows(slice(row, row + 1)) for row in range(len(self._words))]

    def of(self, rows: list[int]) -> Any:
        """The state of some rows: views of a single row, so that a step changes it, or copies of several."""
        return self._views[rows[0]] if len(rows) == 1 else self.state.rows(rows)

    def put(self, rows: list[int], state: StreamState) -> None:
        """Write back a state that `of` gave and a step changed."""
        for whole, part in zip(self.state.arrays(), state.arrays(), strict=True) if len(rows) > 1 else ():
            whole[rows] = part

    def kept(self, row: int) -> Patch:
        """A copy of a whole row."""
        return Patch(slice(None), self._words[row].copy(), [part[row : row + 1].clone() for part in self._tensors])

    def changes(self, row: int, before: Patch) -> Patch:
        """The values of a row that a step overwrote; `before` is the `kept` row from before the step."""
        where = np.flatnonzero(self._words[row] != before.words).astype(np.int32)
        return Patch(where, before.words[where], before.tensors)

    def undo(self, row: int, patch: Patch) -> None:
        """Restore the row to what it was before the step that made this patch."""
        self._words[row, patch.where] = patch.words
        for part, values in zip(self._tensors, patch.tensors, strict=True):
            part[row : row + 1] = values
