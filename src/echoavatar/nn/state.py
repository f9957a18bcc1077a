"""The past of a running module as a value. Loads no torch, so that the stages of motion need none."""

import copy
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Self

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool
    from torch import Tensor


class StreamState:
    """The past of a running module: a dataclass of tensors, arrays or nested states, rows (sessions) first.

    All-zero must mean "nothing seen yet", so that resetting is zeroing.
    """

    def tensors(self) -> "Iterator[Tensor]":
        """Every tensor of the state, nested ones included, in a fixed order; an array as a tensor in its memory."""
        import torch

        for value in vars(self).values():
            for part in value if isinstance(value, list) else [value]:
                if isinstance(part, StreamState):
                    yield from part.tensors()
                else:
                    yield torch.from_numpy(part) if isinstance(part, np.ndarray) else part

    def rows(self, which: "slice | list[int]") -> Self:
        """The state of some rows. A slice gives views: a step on them changes the whole state; a list gives copies."""
        part = copy.copy(self)
        vars(part).update({name: _rows(value, which) for name, value in vars(self).items()})
        return part

    def reset(self, rows: "Bool[Tensor, ' b']") -> None:
        """Forget everything in the chosen rows."""
        for tensor in self.tensors():
            tensor[rows] = 0

    def snapshot(self) -> "list[Tensor]":
        """A copy of every tensor, for `restore`."""
        return [tensor.clone() for tensor in self.tensors()]

    def restore(self, snapshot: "list[Tensor]", rows: "Bool[Tensor, ' b']") -> None:
        """Put the chosen rows back to what they were at `snapshot`."""
        for tensor, saved in zip(self.tensors(), snapshot, strict=True):
            tensor[rows] = saved[rows]


def _rows(value: Any, which: "slice | list[int]") -> Any:
    if isinstance(value, list):
        return [_rows(part, which) for part in value]
    return value.rows(which) if isinstance(value, StreamState) else value[which]
