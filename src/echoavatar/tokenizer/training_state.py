"""Everything a killed tokenizer run needs to go on to the same loss curve, in one safetensors file.

Weights in full precision, the optimiser's averages, the codebooks' moving averages, the random generator, the step.
"""

import json
from pathlib import Path
from typing import Protocol

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from ..checkpoint import load_into
from ..errors import CheckpointError
from .body import BodyTokenizer

STATE_NAME = "training.safetensors"
_MODEL, _OPTIMIZER, _AVERAGES, _GENERATOR = "model.", "optimizer.", "averages.", "generator"


class HasStep(Protocol):
    """A run that knows how far it is."""

    step: int


def save_training(
    folder: Path,
    tokenizer: BodyTokenizer,
    optimizer: torch.optim.Optimizer,
    generator: torch.Generator,
    step: int,
) -> None:
    """Write the state whole or not at all."""
    tensors = {_MODEL + key: value for key, value in tokenizer.state_dict().items()}
    for name, parameter in tokenizer.named_parameters():
        for key, value in optimizer.state[parameter].items():
            tensors[f"{_OPTIMIZER}{name}.{key}"] = value
    tensors |= {_AVERAGES + key: value for key, value in _averages(tokenizer).items()}
    tensors[_GENERATOR] = generator.get_state()
    stored = {key: value.detach().cpu().contiguous().clone() for key, value in tensors.items()}
    partial = folder / (STATE_NAME + ".partial")
    save_file(stored, partial, metadata={"step": str(step), "config": tokenizer.config.model_dump_json()})
    partial.replace(folder / STATE_NAME)


def load_training(
    folder: Path,
    tokenizer: BodyTokenizer,
    optimizer: torch.optim.Optimizer,
    generator: torch.Generator,
    run: HasStep,
) -> None:
    """Put everything back and set `run.step`; drops metrics written after the state was saved.

    Raises:
        CheckpointError: the file is damaged, or was written with other sizes.
    """
    path = folder / STATE_NAME
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata()
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise CheckpointError(f"{path} is damaged ({error}); delete it to start again") from error
    if metadata["config"] != tokenizer.config.model_dump_json():
        raise CheckpointError(
            f"{path} belongs to a tokenizer of other sizes; delete it or use another folder"
        )
    load_into(tokenizer, _under(tensors, _MODEL), origin=str(path))
    for key, value in _averages(tokenizer).items():
        value.copy_(tensors[_AVERAGES + key])
    saved = _under(tensors, _OPTIMIZER)
    for name, parameter in tokenizer.named_parameters():
        optimizer.state[parameter] = {
            key: value.to(parameter.device) for key, value in _under(saved, f"{name}.").items()
        }
    generator.set_state(tensors[_GENERATOR])
    run.step = int(metadata["step"])
    _drop_later_metrics(folder / "metrics.jsonl", run.step)


def _averages(tokenizer: BodyTokenizer) -> dict[str, Tensor]:
    return {
        f"{name}.{key}": value
        for name, part in tokenizer.tokenizers().items()
        for key, value in part.quantizer.training_state().items()
    }


def _under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {key[len(prefix) :]: value for key, value in tensors.items() if key.startswith(prefix)}


def _drop_later_metrics(path: Path, step: int) -> None:
    if path.exists():
        lines = [line for line in path.read_text().splitlines() if json.loads(line)["step"] <= step]
        path.write_text("".join(line + "\n" for line in lines))
