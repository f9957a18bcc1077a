"""The interface of a training task: what it must define, and what it may override.

Runs are reproducible because of this contract: `draw` makes a step's whole batch with everything random in it, and
`loss` is a deterministic function of rows of that batch. A batch can therefore be split into pieces and shared by
processes without changing the run. `TrainingConfig` holds the settings that all tasks share; each task's config adds
its own.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import torch
from pydantic import Field
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar_lab import checkpoint

from .processes import Processes

Schedule = Literal["constant", "cosine", "step"]


class TrainingConfig(Config):
    """How to train. `batch` is the size of one optimiser step, however many processes and pieces share it."""

    steps: int = Field(default=1000, gt=0, description="optimiser steps of the whole schedule")
    minutes: float = Field(default=0.0, ge=0, description="training time, the schedule fitted to it; 0: no limit")
    batch: int = Field(default=8, gt=0, description="rows per optimiser step, of all processes together")
    accumulation: int = Field(
        default=1, gt=0, description="pieces that a process splits its rows into; changes memory, not the result"
    )
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule")
    schedule: Schedule = Field(default="cosine", description="shape of the learning rate after the warm-up")
    warmup: int = Field(default=100, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(default=0.05, ge=0, le=1, description="cosine: share of the peak at the end")
    decay_at: tuple[float, ...] = Field(
        default=(0.5, 0.8), description="step: shares of the run after which the rate drops"
    )
    decay_factor: float = Field(default=0.1, gt=0, le=1, description="step: factor of each drop")
    weight_decay: float = Field(default=0.01, ge=0, description="AdamW's weight decay")
    betas: tuple[float, float] = Field(default=(0.9, 0.99), description="AdamW's betas")
    clip: float = Field(default=1.0, gt=0, description="largest norm of the gradient")
    average: float = Field(default=0.0, ge=0, lt=1, description="decay of the averaged weights that are saved; 0: none")
    autocast: bool = Field(default=False, description="multiply in bfloat16 where the processor is fast at it")
    seed: int = Field(
        default=0,
        description="seed of weights and of everything random in a step; a run with --start sees the same windows again"
        " unless it has another",
    )
    log_every: int = Field(default=1, gt=0, description="steps between lines of metrics.jsonl")
    evaluate_every: int = Field(default=0, ge=0, description="steps between evaluations; 0: none during the run")
    save_every: int = Field(default=200, ge=0, description="steps between checkpoints; 0: by time only")
    save_minutes: float = Field(default=0.0, ge=0, description="minutes between checkpoints; 0: by steps only")

    def noise(self, step: int, salt: int = 0) -> torch.Generator:
        """A generator for everything random in a step; it depends only on seed, step and salt."""
        return torch.Generator().manual_seed(self.seed * 1_000_003 + step + salt)

    def rate_at(self, step: int, done: float | None = None) -> float:
        """Learning rate of a step; `done` is the share of the run completed, by default counted in steps."""
        done = min(1.0, step / self.steps) if done is None else done
        return self.learning_rate * min(1.0, (step + 1) / max(1, self.warmup)) * self.decayed(done)

    def decayed(self, done: float) -> float:
        """Share of the peak rate that is left when a share of the run is done."""
        if self.schedule == "cosine":
            return self.final_rate + (1 - self.final_rate) * 0.5 * (1 + math.cos(math.pi * done))
        if self.schedule == "step":
            return self.decay_factor ** sum(done >= share for share in self.decay_at)
        return 1.0


BatchT = TypeVar("BatchT")
Gather = Callable[[Tensor], Tensor]
"""Concatenates the rows of all pieces and processes, in the order of the batch."""


class Loss(NamedTuple):
    """The mean loss of the given rows, and values to log (also means)."""

    total: Tensor
    metrics: Mapping[str, Tensor | float]


class TrainingTask(ABC, Generic[BatchT]):
    """Config, modules, data and loss. A batch is a tensor or a (nested) tuple of tensors, rows first."""

    kind = ""
    """What cards call the first module, a `Checkpointed` model: it is then saved, and its config identifies the run."""
    has_idle = False
    """Whether some trained parameters get no gradient in some steps; DDP must know."""
    is_recordable = False
    """Whether `loss` only queues the same kernels in each step: it never waits for the device nor uses `step`, and all
    batches have one shape. On a GPU the loop then records the step once and replays it (`loop.Recording`)."""
    seconds = 0.0
    """Training time up to the checkpoint that is being saved."""
    processes = Processes()
    """The processes of the run, set by the loop: `draw` may divide expensive work, if all end with the same batch."""

    def __init__(
        self, config: TrainingConfig, modules: Mapping[str, nn.Module], card: Mapping[str, object] | None = None
    ) -> None:
        """`modules` hold everything that is trained or saved, by the name used in the checkpoint.

        `card` is what the saved model's card says of its data, command and licence.
        """
        self.config = config
        self.modules = dict(modules)
        self._card = dict(card or {})

    @abstractmethod
    def draw(self, step: int) -> BatchT:
        """The whole batch of a step (from 0), on the CPU; every process draws the same batch."""

    @abstractmethod
    def loss(self, batch: BatchT, step: int) -> Loss:
        """Loss of some rows of a batch, on the modules' device; gradients flow only through this."""

    def save(self, folder: Path, step: int) -> None:
        """Write the model after `step` steps, by default the first module; the modules hold the weights to save."""
        model = next(iter(self.modules.values()))
        assert isinstance(model, checkpoint.Checkpointed), "override `save` for other modules"
        model.save(folder, self.card(step))

    def card(self, step: int) -> dict[str, object]:
        """The card of the model after `step` steps."""
        kind = {"kind": self.kind} if self.kind else {}
        return self._card | kind | {"step": step, "training": self.config.model_dump()}

    def begin_with(self, start: Any) -> None:
        """Take the weights of a trained model before a new run; by default they are those of the first module.

        Raises CheckpointError if it is of other sizes.
        """
        name, module = next(iter(self.modules.items()))
        checkpoint.load_into(module, start.state_dict(), origin=f"the {name} to start from")

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW over all trained parameters; called when the modules are on their final device.

        A parameter group with an entry "relative" multiplies the step's learning rate by it.
        """
        return [adamw(self.modules.values(), self.config)]

    def identity(self) -> Mapping[str, Config]:
        """Configs that must match those of the run being resumed: by default the schedule, and the model's sizes."""
        sizes: dict[str, Any] = {self.kind: next(iter(self.modules.values())).config} if self.kind else {}
        return {**sizes, "training": self.config}

    def rate(self, step: int, done: float) -> float:
        """Learning rate of a step; `done` is the share of the run completed, by steps or by time."""
        return self.config.rate_at(step, done)

    def clipped_parameters(self) -> Iterable[nn.Parameter]:
        """The parameters whose gradient norm is logged and clipped to `config.clip`."""
        return (parameter for module in self.modules.values() for parameter in module.parameters())

    def weight(self, batch: BatchT) -> float:
        """Weight of these rows' loss against other rows'; by default their number."""
        return float(row_count(batch))

    def before(self, batch: BatchT, step: int) -> None:  # noqa: B027  (an optional hook)
        """Called with the whole batch before a step."""

    def after(self, step: int, gather: Gather) -> None:  # noqa: B027
        """Called after a step, for what is learned without gradients."""

    def evaluate(self) -> Mapping[str, object]:
        """Measurements on held-out data, every `config.evaluate_every` steps."""
        return {}

    def state(self) -> Mapping[str, Tensor]:
        """Further tensors to save for resuming."""
        return {}

    def load_state(self, state: Mapping[str, Tensor]) -> None:  # noqa: B027
        """Restore what `state` returned."""


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Draw random weights from a seed, on the CPU; torch's own random numbers go on afterwards as before."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


def adamw(
    modules: Iterable[nn.Module],
    config: TrainingConfig,
    *,
    but: Iterable[nn.Parameter] = (),
    decays_vectors: bool = False,
) -> torch.optim.AdamW:
    """AdamW over the trained parameters except `but`; norms and biases have no decay unless `decays_vectors`."""
    left_out = {id(parameter) for parameter in but}
    learned = [
        parameter
        for module in modules
        for parameter in module.parameters()
        if parameter.requires_grad and id(parameter) not in left_out
    ]
    decayed = [p for p in learned if p.dim() > 1 or decays_vectors]
    others = [p for p in learned if not (p.dim() > 1 or decays_vectors)]
    groups = [
        {"params": params, "weight_decay": decay}
        for params, decay in ((decayed, config.weight_decay), (others, 0.0))
        if params
    ]
    return torch.optim.AdamW(groups, lr=config.learning_rate, betas=config.betas, fused=True)


def row_count(batch: Any) -> int:
    """Number of rows in a batch: the length of its first tensor."""
    found = next(tensors_in(batch), None)
    assert found is not None, "a batch needs a tensor"
    return len(found)


def tensors_in(batch: Any) -> Iterator[Tensor]:
    """The tensors of a batch."""
    if isinstance(batch, Tensor):
        yield batch
    elif isinstance(batch, tuple):
        for part in batch:
            yield from tensors_in(part)


def take_rows(batch: Any, rows: slice, device: torch.device) -> Any:
    """Some rows of every tensor of a batch, on a device; other values stay as they are."""
    if isinstance(batch, Tensor):
        chosen = batch[rows]
        is_sent = chosen.device.type == "cpu" and device.type == "cuda"
        return (chosen.pin_memory() if is_sent else chosen).to(device, non_blocking=True)
    if isinstance(batch, tuple):
        parts = [take_rows(part, rows, device) for part in batch]
        return type(batch)(*parts) if hasattr(batch, "_fields") else tuple(parts)
    return batch
