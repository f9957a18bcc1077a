"""One step of the training loop and its state, the same for all tasks and any number of processes.

Checkpoints contain averaged weights (EMA), a slowly moving copy of the trained parameters, where the config asks for
them. On a GPU the forward and backward pass of a step may be recorded once as a CUDA graph and replayed: a small
model's step is a thousand short kernels, and a GPU waits for Python to start each. A replay starts all at once. It
repeats the same kernels on the same memory, so a task must allow it (`TrainingTask.is_recordable`).
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, Generic

import torch
from torch import Tensor, nn
from torch.distributed.tensor import DTensor

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.nn.graphs import capture_cuda

from . import state
from .muon import multiplies_bfloat16
from .processes import Processes, full_state_dicts, full_tensor, placed_like
from .task import BatchT, Loss, TrainingTask, row_count, take_rows, tensors_in

_RAMP = 10  # limits the decay at step n to (1 + n) / (10 + n), so that the random initial weights are soon forgotten


class AveragedWeights:
    """The moving average of all trained parameters, by `module.parameter`."""

    def __init__(self, modules: Mapping[str, nn.Module], decay: float) -> None:
        self.decay = decay
        self._learned = {
            name: parameter for name, parameter in nn.ModuleDict(modules).named_parameters() if parameter.requires_grad
        }
        self.values: dict[str, Tensor] = {key: value.detach().clone() for key, value in self._learned.items()}

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Move the average towards the weights as they are after `step` steps."""
        share = 1 - min(self.decay, (1 + step) / (_RAMP + step))
        learned = [self._learned[key].detach().to(value.dtype) for key, value in self.values.items()]
        torch._foreach_lerp_(list(self.values.values()), learned, share)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Context in which the modules hold the averaged weights."""
        own = {key: value.detach().clone() for key, value in self._learned.items()}
        self._write(self.values)
        try:
            yield
        finally:
            self._write(own)

    @torch.no_grad()
    def _write(self, values: Mapping[str, Tensor]) -> None:
        for key, value in values.items():
            self._learned[key].copy_(value)


Values = Mapping[str, Tensor | float]


class Recording:
    """A function of a batch, recorded at its first call."""

    def __init__(
        self,
        run: Callable[[Any], Values],
        device: torch.device,
        *,
        capture: Callable[[Callable[[], Values]], Callable[[], Values]] = capture_cuda,
    ) -> None:
        """`run` queues the kernels of a pass and returns values; it must write into new gradients."""
        self._run, self._device, self._capture = run, device, capture
        self._batch: Any = None
        self._replay: Callable[[], Values] | None = None

    def __call__(self, batch: Any) -> Values:
        """The values for a batch on the CPU; they and the gradients are valid until the next call.

        Raises RuntimeError if the batch has other shapes than the first.
        """
        if self._replay is None:
            self._batch = take_rows(batch, slice(None), self._device)
            self._replay = self._capture(lambda: self._run(self._batch))
        sent = take_rows(batch, slice(None), self._device)
        for own, new in zip(tensors_in(self._batch), tensors_in(sent), strict=True):
            own.copy_(new)
        return self._replay()


class _LossModule(nn.Module):
    """All modules of a task as one module whose forward pass is the loss, as DDP and FSDP require."""

    def __init__(self, stage: TrainingTask[Any]) -> None:
        super().__init__()
        self.parts = nn.ModuleDict(stage.modules)
        self._loss = stage.loss

    def forward(self, batch: Any, step: int) -> Loss:
        return self._loss(batch, step)


class Loop(Generic[BatchT]):
    """A task, its optimisers, and its progress. `train` runs it to the end."""

    def __init__(self, stage: TrainingTask[BatchT], processes: Processes | None = None) -> None:
        """Raises EchoAvatarError if the batch cannot be divided evenly."""
        self.stage, self.processes = stage, processes or Processes()
        stage.processes = self.processes
        self._pieces = self.processes.count * stage.config.accumulation
        if stage.config.batch % self._pieces:
            raise EchoAvatarError(
                f"batch ({stage.config.batch}) must be a multiple of processes x accumulation "
                f"({self.processes.count} x {stage.config.accumulation})"
            )
        self._loss_module = self.processes.wrap(_LossModule(stage), has_idle=stage.has_idle)
        for module in stage.modules.values():
            module.train()
        self.optimisers = stage.optimisers()
        self.average = AveragedWeights(stage.modules, stage.config.average) if stage.config.average else None
        self.step = 0
        self.seconds = 0.0
        is_one_piece = self._pieces == 1 and self.processes.device.type == "cuda"
        is_recorded = is_one_piece and stage.is_recordable
        self._recording = Recording(self._pass_once, self.processes.device) if is_recorded else None
        self._autocast = stage.config.autocast and multiplies_bfloat16(self.processes.device)

    def done(self) -> float:
        """Share of the run completed, by steps or by time, whichever is larger."""
        config = self.stage.config
        by_clock = self.seconds / 60 / config.minutes if config.minutes else 0.0
        return min(1.0, max(self.step / config.steps, by_clock))

    def advance(self, *, is_logged: bool = True) -> dict[str, float]:
        """One optimiser step. Returns its metrics if `is_logged`, which waits for the device.

        Raises EchoAvatarError if the loss is not finite (checked only if `is_logged`).
        """
        stage, step = self.stage, self.step
        whole_batch = stage.draw(step)
        stage.before(whole_batch, step)
        rate = stage.rate(step, self.done())
        for optimiser in self.optimisers:
            for group in optimiser.param_groups:
                group["lr"] = rate * group.get("relative", 1.0)
        rows, every = row_count(whole_batch) // self._pieces, stage.weight(whole_batch)
        assert rows * self._pieces == row_count(whole_batch), "a batch must have as many rows for each piece"
        first, means = self.processes.rank * stage.config.accumulation, _Means()
        for piece in range(first, first + stage.config.accumulation):
            batch = take_rows(whole_batch, slice(piece * rows, (piece + 1) * rows), _CPU)
            share = stage.weight(batch) / every
            is_last = piece == first + stage.config.accumulation - 1
            with nullcontext() if is_last else self.processes.without_reduction(self._loss_module):
                means.add(self._pass(batch, share) if self._recording is None else self._recording(batch), share)
        norm = self._descend()
        stage.after(step, self.processes.gather)
        if self.average is not None:
            self.average.update(step)
        self.step += 1
        if not is_logged:
            return {}
        metrics = means.over(self.processes) | {"gradient": float(norm), "rate": rate}
        if not abs(metrics["loss"]) < float("inf"):
            raise EchoAvatarError(
                f"the loss is {metrics['loss']} at step {self.step}; begin another run with a lower learning rate or "
                "without autocast (what was saved before can be its --start)"
            )
        return metrics

    def _pass(self, batch: BatchT, share: float) -> Mapping[str, Tensor | float]:
        """Forward and backward pass of a piece; its loss and metrics."""
        device = self.processes.device
        with torch.autocast(device.type, torch.bfloat16, enabled=self._autocast):
            loss = self._loss_module(take_rows(batch, slice(None), device), self.step)
        # processes average their gradients, but the shares add up over all processes
        (loss.total * (share * self.processes.count)).backward()
        return {"loss": loss.total.detach(), **loss.metrics}

    def _pass_once(self, batch: BatchT) -> Mapping[str, Tensor | float]:
        """The pass of a whole batch, into new gradients."""
        self._loss_module.zero_grad(set_to_none=True)
        return self._pass(batch, 1.0)

    def _descend(self) -> Tensor:
        learned = [parameter for parameter in self.stage.clipped_parameters() if parameter.grad is not None]
        norm = nn.utils.clip_grad_norm_(learned, self.stage.config.clip)
        for optimiser in self.optimisers:
            optimiser.step()
        if self._recording is None:  # which writes over the gradients
            self._loss_module.zero_grad(set_to_none=True)
        return norm.full_tensor() if isinstance(norm, DTensor) else norm

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Context in which the modules hold the weights to save; all processes must enter it."""
        averaged = self.average.applied() if self.average is not None else nullcontext()
        with averaged, full_state_dicts(self.stage.modules):
            yield
        for module in self.stage.modules.values():
            module.train()

    def save(self, folder: Path) -> None:
        """Write the state for resuming, then the model; all processes must call it, only the first one writes."""
        stage, modules = self.stage, self.stage.modules
        tensors = state.module_state(modules) | state.optimiser_state(modules, self.optimisers)
        if self.average is not None:
            tensors |= {f"average.{key}": full_tensor(value) for key, value in self.average.values.items()}
        random = state.random_state(self.processes.device).to(self.processes.device)
        tensors["random"] = self.processes.gather(random[None])
        tensors |= {f"stage.{key}": value for key, value in stage.state().items()}
        stage.seconds = self.seconds
        if self.processes.is_first:
            make_output_folder(folder)
            facts = {"step": self.step, "seconds": self.seconds, "identity": self._identity()}
            state.write(folder / state.FILE, tensors, facts)
        with self.shown():
            if self.processes.is_first:
                stage.save(folder, self.step)
        self.processes.wait()

    def resume(self, folder: Path) -> bool:
        """Continue where `save` stopped; False if the folder holds no run.

        Raises CheckpointError if the folder holds another model or schedule, is damaged, or is too old.
        """
        if not state.has_state(folder):
            return False
        path = folder / state.FILE
        tensors, facts = state.read(path)
        self._agree(folder, facts["identity"])
        modules = self.stage.modules
        state.load_modules(modules, tensors, str(path))
        state.load_optimisers(modules, self.optimisers, tensors)
        if self.average is not None:
            self.average = AveragedWeights(modules, self.stage.config.average)
            averaged = state.strip_prefix(tensors, "average.")
            for key in sorted(averaged.keys() & self.average.values.keys()):
                self.average.values[key] = placed_like(averaged[key], self.average.values[key])
        if self.processes.rank < len(tensors["random"]):
            state.load_random_state(tensors["random"][self.processes.rank], self.processes.device)
        self.stage.load_state(state.strip_prefix(tensors, "stage."))
        self.step, self.seconds = int(str(facts["step"])), float(str(facts["seconds"]))
        return True

    def _identity(self) -> dict[str, Any]:
        return {name: config.model_dump(mode="json") for name, config in self.stage.identity().items()}

    def _agree(self, folder: Path, saved: Any) -> None:
        for name, ours in self._identity().items():
            theirs = saved.get(name, {})
            differing = [key for key in sorted(ours.keys() | theirs.keys()) if ours.get(key) != theirs.get(key)]
            differing = [key for key in differing if key not in _FREE]
            if differing:
                key = differing[0]
                raise CheckpointError(
                    f"{folder} holds a run of another {name} config: {key} was {theirs.get(key)}, is "
                    f"{ours.get(key)}; train into another folder"
                )


_CPU = torch.device("cpu")
_FREE = ("accumulation", "log_every", "evaluate_every", "save_every", "save_minutes")  # do not change the result


class _Means:
    """Means of metrics over pieces; a metric that some pieces lack, or where it is NaN, is averaged over the others."""

    def __init__(self) -> None:
        self._values: dict[str, list[tuple[Tensor | float, float]]] = defaultdict(list)

    def add(self, values: Mapping[str, Tensor | float], share: float) -> None:
        for name, value in values.items():
            self._values[name].append((value.detach() if isinstance(value, Tensor) else value, share))

    def over(self, processes: Processes) -> dict[str, float]:
        own = {name: [(float(value), share) for value, share in pairs] for name, pairs in self._values.items()}
        found: dict[str, list[tuple[float, float]]] = defaultdict(list)
        for one in processes.gather_json(own):
            for name, pairs in one.items():
                found[name] += [(v, share) for v, share in pairs if not math.isnan(v) or name == "loss"]
        shares = {name: sum(share for _, share in pairs) for name, pairs in found.items()}
        return {name: sum(v * s for v, s in pairs) / shares[name] for name, pairs in found.items() if shares[name]}
