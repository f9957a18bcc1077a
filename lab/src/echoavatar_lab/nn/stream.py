"""The streaming contract: state is a value, rows are sessions, offline is one step from a fresh state."""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import torch
from jaxtyping import Bool
from torch import Tensor, nn

from echoavatar.nn.state import StreamState

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
    """Copy `value` into `target` in place, in the active rows only; in a graph that is exported, all are active."""
    if torch.compiler.is_exporting():
        target.copy_(value)
        return
    where = active.view(-1, *([1] * (target.dim() - 1)))
    target.copy_(torch.where(where, value, target))
