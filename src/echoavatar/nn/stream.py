"""The streaming contract: state is a value, rows are sessions, offline is one step from a fresh state."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, Generic, Self, TypeVar

import torch
from jaxtyping import Bool
from torch import Tensor, nn


class StreamState:
    """The past of a running module: a dataclass of tensors (or nested states), rows (sessions) first.

    All-zero must mean "nothing seen yet", so that resetting is zeroing.
    """

    def tensors(self) -> Iterator[Tensor]:
        """Every tensor of the state, nested ones included, in a fixed order."""
        for value in vars(self).values():
            if isinstance(value, Tensor):
                yield value
            else:
                for part in value if isinstance(value, list) else [value]:
                    yield from part.tensors()

    def rows(self, which: slice) -> Self:
        """The state of some rows, as views: a step on them changes the whole state."""
        part = copy.copy(self)
        vars(part).update({name: _rows(value, which) for name, value in vars(self).items()})
        return part

    def reset(self, rows: Bool[Tensor, " b"]) -> None:
        """Forget everything in the chosen rows."""
        for tensor in self.tensors():
            tensor[rows] = 0

    def snapshot(self) -> list[Tensor]:
        """A copy of every tensor, for `restore`."""
        return [tensor.clone() for tensor in self.tensors()]

    def restore(self, snapshot: list[Tensor], rows: Bool[Tensor, " b"]) -> None:
        """Put the chosen rows back to what they were at `snapshot`."""
        for tensor, saved in zip(self.tensors(), snapshot, strict=True):
            tensor[rows] = saved[rows]


def _rows(value: Any, which: slice) -> Any:
    if isinstance(value, Tensor):
        return value[which]
    return [_rows(part, which) for part in value] if isinstance(value, list) else value.rows(which)


StateT = TypeVar("StateT", bound=StreamState)


class StreamingModule(nn.Module, ABC, Generic[StateT]):
    """`forward(x)` sees a whole clip; `step(x, state, active)` sees the next frames of running ones."""

    @abstractmethod
    def init_state(self, rows: int) -> StateT:
        """A fresh state: nothing seen yet."""

    @abstractmethod
    def step(self, x: Tensor, state: StateT, active: Bool[Tensor, " b"]) -> Tensor:
        """Advance `state` in place where `active`; other rows stay untouched."""


def write_rows(target: Tensor, value: Tensor, active: Bool[Tensor, " b"]) -> None:
    """Copy `value` into `target` in place, in the active rows only."""
    where = active.view(-1, *([1] * (target.dim() - 1)))
    target.copy_(torch.where(where, value, target))
