from pathlib import Path

import pytest
import torch
from torch import nn

from echoavatar import checkpoint
from echoavatar.config import Config
from echoavatar.errors import CheckpointError


class Shape(Config):
    width: int = 4


def write(folder: Path, dtype: torch.dtype | None = None) -> nn.Linear:
    torch.manual_seed(0)
    layer = nn.Linear(4, 3)
    checkpoint.save(folder, config=Shape(), weights=layer.state_dict(), card={"data": "none"}, dtype=dtype)
    return layer


def test_what_is_saved_comes_back(tmp_path: Path) -> None:
    layer = write(tmp_path)
    other = nn.Linear(4, 3)
    checkpoint.load_into(other, checkpoint.read_weights(tmp_path), origin="test")
    assert torch.equal(layer.weight, other.weight)
    assert checkpoint.read_config(tmp_path, Shape) == Shape()
    assert checkpoint.read_card(tmp_path) == {"data": "none"}


def test_half_precision_storage_loads_as_float32(tmp_path: Path) -> None:
    layer = write(tmp_path, torch.float16)
    weights = checkpoint.read_weights(tmp_path)
    assert weights["weight"].dtype == torch.float32
    torch.testing.assert_close(weights["weight"], layer.weight, atol=1e-3, rtol=1e-3)


def test_every_mismatch_is_named() -> None:
    weights = {"weight": torch.zeros(3, 5), "extra": torch.zeros(1)}
    with pytest.raises(
        CheckpointError, match=r"missing bias; unknown extra; weight is \(3, 5\), wanted \(3, 4\)"
    ):
        checkpoint.load_into(nn.Linear(4, 3), weights, origin="the file")


def test_a_missing_folder_a_damaged_file_and_a_wrong_field_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"config\.json is missing"):
        checkpoint.read_config(tmp_path / "nowhere", Shape)
    write(tmp_path)
    (tmp_path / "config.json").write_text('{"width": "wide"}')
    with pytest.raises(CheckpointError, match="width"):
        checkpoint.read_config(tmp_path, Shape)
    stored = (tmp_path / "model.safetensors").read_bytes()
    (tmp_path / "model.safetensors").write_bytes(stored[: len(stored) // 2])
    with pytest.raises(CheckpointError, match="damaged"):
        checkpoint.read_weights(tmp_path)
