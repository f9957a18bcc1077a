"""A checkpoint is a folder: `config.json`, `model.safetensors`, `card.json`. Loading is strict and says what is wrong.

Uses `config`, `timing` and `errors` only. Nothing is ever unpickled.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import torch
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from .config import Config
from .errors import CheckpointError

ConfigT = TypeVar("ConfigT", bound=Config)


def read_config(folder: Path, kind: type[ConfigT]) -> ConfigT:
    """Read and check `config.json`.

    Raises:
        CheckpointError: the folder or file is missing, or a field does not fit.
    """
    path = folder / "config.json"
    try:
        return kind.model_validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise CheckpointError(f"{folder} is not a checkpoint: config.json is missing") from error
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise CheckpointError(f"{path}: {field}: {first['msg']}") from error


def read_card(folder: Path) -> dict[str, object]:
    """The model card (data, command, scores, licence), or an empty one where there is none."""
    path = folder / "card.json"
    if not path.exists():
        return {}
    try:
        card = json.loads(path.read_text())
    except ValueError as error:
        raise CheckpointError(f"{path} is not valid JSON: {error}") from error
    return dict(card)


def read_weights(folder: Path) -> dict[str, Tensor]:
    """Read `model.safetensors`; half-precision storage becomes float32."""
    path = folder / "model.safetensors"
    try:
        weights = load_file(path)
    except FileNotFoundError as error:
        raise CheckpointError(f"{folder} is not a checkpoint: model.safetensors is missing") from error
    except SafetensorError as error:
        raise CheckpointError(f"{path} is damaged ({error}); copy or download it again") from error
    half = (torch.float16, torch.bfloat16)
    return {key: value.float() if value.dtype in half else value for key, value in weights.items()}


def load_into(module: nn.Module, weights: Mapping[str, Tensor], *, origin: str) -> None:
    """Strictly load `weights`; every missing, extra and misshapen key is named.

    Raises:
        CheckpointError: keys or shapes differ.
    """
    own = module.state_dict()
    problems = [f"missing {key}" for key in own if key not in weights]
    problems += [f"unknown {key}" for key in weights if key not in own]
    problems += [
        f"{key} is {tuple(weights[key].shape)}, wanted {tuple(own[key].shape)}"
        for key in own
        if key in weights and weights[key].shape != own[key].shape
    ]
    if problems:
        shown = "; ".join(problems[:6]) + (f"; and {len(problems) - 6} more" if len(problems) > 6 else "")
        raise CheckpointError(f"{origin} does not fit this model: {shown}")
    module.load_state_dict(dict(weights))


def save(
    folder: Path,
    *,
    config: Config,
    weights: Mapping[str, Tensor],
    card: Mapping[str, object],
    dtype: torch.dtype | None = None,
) -> None:
    """Write a checkpoint folder whole or not at all; `dtype` stores floating weights in that precision."""
    folder.mkdir(parents=True, exist_ok=True)
    stored = {
        key: (value.to(dtype) if dtype is not None and value.is_floating_point() else value)
        .detach()
        .cpu()
        .contiguous()
        for key, value in weights.items()
    }
    partial = folder / "model.safetensors.partial"
    save_file(stored, partial)
    partial.replace(folder / "model.safetensors")
    _write_text(folder / "config.json", config.model_dump_json(indent=2))
    _write_text(folder / "card.json", json.dumps(dict(card), indent=2))


def _write_text(path: Path, text: str) -> None:
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text + "\n")
    partial.replace(path)
