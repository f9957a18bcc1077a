"""The state of a run in one safetensors file, from which it resumes to the same losses; written atomically.

It holds the weights in full precision, the codebooks' running averages, the optimisers' state, averaged weights,
torch's random generators, the task's own state and the step. Everything is stored by name, so that a run may be resumed
with another number of processes.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from echoavatar.errors import CheckpointError
from echoavatar.json_reader import read_object
from echoavatar.limits import check_file
from echoavatar.stored import LARGEST_WEIGHTS_BYTES
from echoavatar.whole_file import whole_file
from echoavatar_lab import checkpoint

from .processes import full_tensor, placed_like

FILE = "training.safetensors"
_FORMAT = "2"


@runtime_checkable
class HasTrainingState(Protocol):
    """A module with buffers that its state dict omits (`quantize.LearningQuantizer`)."""

    def training_state(self) -> dict[str, Tensor]:
        """The omitted buffers."""


def has_state(folder: Path) -> bool:
    """Whether the folder holds a run to resume."""
    return (folder / FILE).exists()


def write(path: Path, tensors: Mapping[str, Tensor], facts: Mapping[str, object]) -> None:
    """Write the file; `facts` must be JSON. Raises CheckpointError if it cannot be written."""
    stored = {key: value.detach().cpu().contiguous().clone() for key, value in tensors.items()}
    metadata = {"format": _FORMAT, "facts": json.dumps(dict(facts))}
    with whole_file(path, error=CheckpointError, failures=(SafetensorError,), is_flushed=True) as partial:
        save_file(stored, partial, metadata=metadata)


def read(path: Path) -> tuple[dict[str, Tensor], dict[str, object]]:
    """Read tensors and facts. Raises CheckpointError if the file is damaged, or of another version."""
    try:
        check_file(path, LARGEST_WEIGHTS_BYTES, CheckpointError)
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != _FORMAT:
                raise CheckpointError(
                    f"{path} was written by another version, whose runs cannot be resumed; train into another folder "
                    f"(the model in {path.parent} can be its --start), or delete the file to start again"
                )
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        return tensors, read_object(metadata.get("facts"), f"{path}: facts", error=CheckpointError)
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path} is damaged ({error}); delete it to start again") from error


def module_state(modules: Mapping[str, nn.Module]) -> dict[str, Tensor]:
    """Weights and buffers, including those that state dicts omit."""
    found = {f"model.{key}": full_tensor(value) for key, value in nn.ModuleDict(modules).state_dict().items()}
    return found | {f"beside.{key}": value for key, value in _beside(modules)}


@torch.no_grad()
def load_modules(modules: Mapping[str, nn.Module], tensors: Mapping[str, Tensor], origin: str) -> None:
    """Restore weights and buffers. Raises CheckpointError: names or shapes differ."""
    together = nn.ModuleDict(modules)
    own, saved = together.state_dict(), strip_prefix(tensors, "model.")
    placed = {key: placed_like(value, own[key]) if key in own else value for key, value in saved.items()}
    checkpoint.load_into(together, placed, origin=origin)
    beside = strip_prefix(tensors, "beside.")
    for key, value in _beside(modules):
        value.copy_(beside[key])


def optimiser_state(modules: Mapping[str, nn.Module], optimisers: Sequence[torch.optim.Optimizer]) -> dict[str, Tensor]:
    """The optimisers' state of each parameter, by its name."""
    return {
        f"optimiser.{name}.{key}": full_tensor(torch.as_tensor(value))
        for name, parameter in nn.ModuleDict(modules).named_parameters()
        for optimiser in optimisers
        if parameter in optimiser.state
        for key, value in optimiser.state[parameter].items()
    }


def load_optimisers(
    modules: Mapping[str, nn.Module], optimisers: Sequence[torch.optim.Optimizer], tensors: Mapping[str, Tensor]
) -> None:
    """Restore the optimisers' state."""
    saved: dict[str, dict[str, Tensor]] = {}
    for key, value in strip_prefix(tensors, "optimiser.").items():
        name, which = key.rsplit(".", 1)
        saved.setdefault(name, {})[which] = value
    owners = {
        id(parameter): optimiser
        for optimiser in optimisers
        for group in optimiser.param_groups
        for parameter in group["params"]
    }
    for name, parameter in nn.ModuleDict(modules).named_parameters():
        if name in saved and id(parameter) in owners:
            owners[id(parameter)].state[parameter] = {
                # fused optimisers want their count of steps on the parameter's device
                key: placed_like(value, parameter) if value.shape == parameter.shape else value.to(parameter.device)
                for key, value in saved[name].items()
            }


def random_state(device: torch.device) -> Tensor:
    """State of torch's global generators: the CPU's, then the CUDA device's if there is one."""
    states = [torch.get_rng_state()]
    if device.type == "cuda":
        states.append(torch.cuda.get_rng_state(device))
    return torch.cat(states)


def load_random_state(state: Tensor, device: torch.device) -> None:
    """Restore the generators."""
    cpu = len(torch.get_rng_state())
    torch.set_rng_state(state[:cpu].cpu().clone())  # a copy, because torch ignores a view's offset
    if device.type == "cuda" and len(state) > cpu:
        torch.cuda.set_rng_state(state[cpu:].cpu().clone(), device)


def strip_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The entries whose names start with `prefix`, without it."""
    return {key[len(prefix) :]: value for key, value in tensors.items() if key.startswith(prefix)}


def _beside(modules: Mapping[str, nn.Module]) -> Iterator[tuple[str, Tensor]]:
    """Buffers that state dicts omit, by name; a module that reports its own also reports those of its children."""
    for name, module in modules.items():
        reported: set[int] = set()
        for path, part in module.named_modules():
            if id(part) not in reported and isinstance(part, HasTrainingState):
                assert isinstance(part, nn.Module)
                reported.update(id(inner) for inner in part.modules())
                for key, value in part.training_state().items():
                    yield f"{name}.{path}.{key}", value
