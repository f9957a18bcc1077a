"""What a stage of training must say, and what it may: the loop does the rest.

The contract that makes runs repeat: `draw` makes a step's whole batch with everything random in it, and `loss` is a
plain function of rows of it. So a batch may be cut into pieces and shared by processes without changing the run.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor, nn

from ..config import Config
from .config import TrainingConfig
from .optimisers import adamw
from .processes import Processes

BatchT = TypeVar("BatchT")
Gather = Callable[[Tensor], Tensor]
"""Puts the rows of all pieces and processes together, in the order of the batch."""


class Loss(NamedTuple):
    """The mean loss of the rows given, to be minimised, and what the log keeps of them (means as well)."""

    total: Tensor
    told: Mapping[str, Tensor | float]


class Stage(ABC, Generic[BatchT]):
    """Config, modules, data, loss. A batch is tensors, rows first, in tuples as deep as wanted."""

    has_idle = False
    """Whether some of what learns gets no gradient in some steps; several processes must know."""
    seconds = 0.0
    """Time spent in steps up to the checkpoint that is being saved."""
    processes = Processes()
    """Those that share the run, set by the loop: `draw` may divide dear work among them, if all end with one batch."""

    def __init__(self, config: TrainingConfig, modules: Mapping[str, nn.Module]) -> None:
        """`modules` are all that learns or remembers, by the name under which it is kept."""
        self.config = config
        self.modules = dict(modules)

    @abstractmethod
    def draw(self, step: int) -> BatchT:
        """The whole batch of a step (from 0), on the CPU; every process draws the same."""

    @abstractmethod
    def loss(self, batch: BatchT, step: int) -> Loss:
        """Of rows of a batch, on the modules' device; the only place through which gradients flow."""

    @abstractmethod
    def save(self, folder: Path, step: int) -> None:
        """Write what others load, after `step` steps; the modules hold the weights to be shown."""

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW over all that learns; asked for once the modules are where they will be trained.

        A group of parameters with an entry "relative" has so many times the rate of the step.
        """
        return [adamw(self.modules.values(), self.config)]

    def identity(self) -> Mapping[str, Config]:
        """What a run must agree in with the folder it goes on in."""
        return {"training": self.config}

    def rate(self, step: int, done: float) -> float:
        """Learning rate of a step; `done` is the share of the run behind it, by steps or by the clock."""
        return self.config.rate_at(step, done)

    def clipped(self) -> Iterable[nn.Parameter]:
        """The parameters whose gradient's norm is told and kept below `config.clip`."""
        return (parameter for module in self.modules.values() for parameter in module.parameters())

    def weight(self, batch: BatchT) -> float:
        """How much the loss of these rows counts against others: by default how many they are."""
        return float(rows_of(batch))

    def before(self, batch: BatchT, step: int) -> None:  # noqa: B027  (a hook, not a duty)
        """Called with the whole batch before a step."""

    def after(self, step: int, gather: Gather) -> None:  # noqa: B027
        """Called after a step: what learns by other means than gradients."""

    def evaluate(self) -> Mapping[str, object]:
        """Measurements on held-out data, every `config.evaluate_every` steps."""
        return {}

    def state(self) -> Mapping[str, Tensor]:
        """What else a resumed run must remember."""
        return {}

    def load_state(self, state: Mapping[str, Tensor]) -> None:  # noqa: B027
        """Take it back."""


def rows_of(batch: Any) -> int:
    """How many rows a batch has: the length of its first tensor."""
    found = next(leaves(batch), None)
    assert found is not None, "a batch needs a tensor"
    return len(found)


def leaves(batch: Any) -> Iterator[Tensor]:
    """The tensors of a batch."""
    if isinstance(batch, Tensor):
        yield batch
    elif isinstance(batch, tuple):
        for part in batch:
            yield from leaves(part)


def cut(batch: Any, rows: slice, device: torch.device) -> Any:
    """Some rows of every tensor of a batch, on a device; what is no tensor stays as it is."""
    if isinstance(batch, Tensor):
        return batch[rows].to(device, non_blocking=True)
    if isinstance(batch, tuple):
        parts = [cut(part, rows, device) for part in batch]
        return type(batch)(*parts) if hasattr(batch, "_fields") else tuple(parts)
    return batch
