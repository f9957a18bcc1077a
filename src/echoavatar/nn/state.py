"""The past of a running module as a value."""

from collections.abc import Callable, Iterator
from typing import Any, Self

import numpy as np
from jaxtyping import Bool


class StreamState:
    """The past of a running module: a dataclass of arrays or nested states, rows (sessions) first.

    Torch modules keep tensors in it. All-zero must mean "nothing seen yet", so that resetting is zeroing.
    """

    def arrays(self) -> Iterator[Any]:
        """Every array of the state, nested ones included, in a fixed order."""
        for value in vars(self).values():
            for part in value if isinstance(value, list) else [value]:
                if isinstance(part, StreamState):
                    yield from part.arrays()
                else:
                    yield part

    def mapped(self, change: Callable[[Any], Any]) -> Self:
        """The same state with other arrays: what `change` makes of each, in the order of `arrays`."""
        new = object.__new__(type(self))  # `copy` takes five times as long, and a chunk maps a hundred states
        vars(new).update({name: _mapped(value, change) for name, value in vars(self).items()})
        return new

    def rows(self, which: slice | list[int]) -> Self:
        """The state of some rows. A slice gives views: a step on them changes the whole state; a list gives copies."""
        return self.mapped(lambda part: part[which])

    def reset(self, rows: Bool[np.ndarray, " b"]) -> None:
        """Forget everything in the chosen rows."""
        for part in self.arrays():
            part[rows] = 0

    def overwrite(self, rows: Bool[np.ndarray, " b"], source: Self) -> None:
        """Make the chosen rows equal to the one row of `source`."""
        for part, row in zip(self.arrays(), source.arrays(), strict=True):
            part[rows] = row


def _mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    if isinstance(value, list):
        return [_mapped(part, change) for part in value]
    return value.mapped(change) if isinstance(value, StreamState) else change(value)
