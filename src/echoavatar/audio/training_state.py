"""What a stopped codec training needs besides the codec itself, as one safetensors file.

May import `checkpoint` and below.
"""

from pathlib import Path
from typing import Protocol

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from ..checkpoint import load_into
from ..errors import CheckpointError
from ..quantize import ResidualVectorQuantizer

_FILE = "training.safetensors"


class Trainer(Protocol):
    """The parts of a trainer that are kept."""

    quantizer: ResidualVectorQuantizer
    optimizer: torch.optim.AdamW
    steps_done: int
    seconds: float

    def state_dict(self) -> dict[str, Tensor]:
        """Of all modules."""


def save_training(folder: Path, trainer: Trainer) -> None:
    """Write the file whole or not at all."""
    tensors = {f"model.{name}": value for name, value in trainer.state_dict().items()}
    tensors |= {f"quantizer.{name}": value for name, value in trainer.quantizer.training_state().items()}
    for index, moments in trainer.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{name}": torch.as_tensor(value) for name, value in moments.items()}
    tensors["steps_done"] = torch.tensor(trainer.steps_done)
    tensors["seconds"] = torch.tensor(trainer.seconds, dtype=torch.float64)
    partial = folder / (_FILE + ".partial")
    save_file({name: value.detach().contiguous().clone() for name, value in tensors.items()}, partial)
    partial.replace(folder / _FILE)


def load_training(folder: Path, trainer: Trainer) -> bool:
    """Go on where `save_training` left off; False where there is nothing to go on with.

    Raises:
        CheckpointError: the file is damaged or of another model.
    """
    path = folder / _FILE
    if not path.exists():
        return False
    try:
        tensors = load_file(path)
    except SafetensorError as error:
        raise CheckpointError(f"{path} is damaged ({error}); delete it to start over") from error
    assert isinstance(trainer, nn.Module)
    load_into(trainer, _under(tensors, "model."), origin=str(path))
    trainer.quantizer.load_training_state(_under(tensors, "quantizer."))
    state = trainer.optimizer.state_dict()
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in _under(tensors, "optimizer.").items():
        index, key = name.split(".", 1)
        moments.setdefault(int(index), {})[key] = value
    state["state"] = moments
    trainer.optimizer.load_state_dict(state)
    trainer.steps_done = int(tensors["steps_done"])
    trainer.seconds = float(tensors["seconds"])
    return True


def _under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
