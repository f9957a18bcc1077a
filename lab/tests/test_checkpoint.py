import os
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from echoavatar.config import Config
from echoavatar.errors import CheckpointError
from echoavatar.stored import read_card, read_config, round_to_int8
from echoavatar_lab import checkpoint
from echoavatar_lab.checkpoint import Checkpointed


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
    assert read_config(tmp_path, Shape) == Shape()
    assert read_card(tmp_path) == {"data": "none"}


def test_half_precision_storage_loads_as_float32(tmp_path: Path) -> None:
    layer = write(tmp_path, torch.float16)
    weights = checkpoint.read_weights(tmp_path)
    assert weights["weight"].dtype == torch.float32
    torch.testing.assert_close(weights["weight"], layer.weight, atol=1e-3, rtol=1e-3)


def test_int8_storage_keeps_each_row_to_a_step(tmp_path: Path) -> None:
    """What was stored once is stored again without a change: the integers are those of `Int8Linear`."""
    layer = write(tmp_path, torch.int8)
    weights = checkpoint.read_weights(tmp_path)
    assert weights["weight"].dtype == torch.float32
    step = layer.weight.abs().amax(1, keepdim=True) / 127
    assert ((weights["weight"] - layer.weight).abs() < step).all()
    torch.testing.assert_close(weights["bias"], layer.bias, atol=1e-3, rtol=1e-3)
    checkpoint.save(tmp_path / "again", config=Shape(), weights=weights, card={}, dtype=torch.int8)
    torch.testing.assert_close(checkpoint.read_weights(tmp_path / "again"), weights, rtol=1e-6, atol=0)
    stored = load_file(tmp_path / "model.safetensors")
    save_file({"weight.int8_scale": stored["weight.int8_scale"]}, tmp_path / "model.safetensors")
    with pytest.raises(CheckpointError, match="has no weights of its size"):
        checkpoint.read_weights(tmp_path)


def test_training_of_less_than_a_step_survives_int8() -> None:
    """Rounded to the nearest integer, all of it would be undone."""
    weight = torch.randn(64, 512, generator=torch.Generator().manual_seed(0))
    weight[:, 0] = 5  # keeps the scale
    rounded, scale = map(torch.from_numpy, round_to_int8(weight.numpy()))
    stored = rounded * scale
    moved = stored + 0.1 * scale
    moved[:, 0] = 5
    again, same = map(torch.from_numpy, round_to_int8(moved.numpy()))
    torch.testing.assert_close(same, scale)
    assert ((again - rounded).float().mean() - 0.1).abs() < 0.01
    x = torch.ones(512)
    torch.testing.assert_close((again * same) @ x, moved @ x, atol=1, rtol=0)
    assert torch.equal(torch.from_numpy(round_to_int8(stored.numpy())[0]), rounded)


def test_every_mismatch_is_named() -> None:
    weights = {"weight": torch.zeros(3, 5), "extra": torch.zeros(1)}
    with pytest.raises(CheckpointError, match=r"missing bias; unknown extra; weight is \(3, 5\), wanted \(3, 4\)"):
        checkpoint.load_into(nn.Linear(4, 3), weights, origin="the file")


def test_a_missing_folder_a_damaged_file_and_a_wrong_field_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"config\.json is missing"):
        read_config(tmp_path / "nowhere", Shape)
    write(tmp_path)
    (tmp_path / "config.json").write_text('{"width": "wide"}')
    with pytest.raises(CheckpointError, match="width"):
        read_config(tmp_path, Shape)
    stored = (tmp_path / "model.safetensors").read_bytes()
    (tmp_path / "model.safetensors").write_bytes(stored[: len(stored) // 2])
    with pytest.raises(CheckpointError, match="damaged"):
        checkpoint.read_weights(tmp_path)


class Stack(Config):
    layers: int = 1
    width: int = 4


def stack(config: Stack) -> nn.Module:
    return nn.Sequential(*(nn.Linear(config.width, config.width) for _ in range(config.layers)))


def stored(folder: Path, **asked: int) -> Path:
    module = stack(Stack())
    checkpoint.save(folder, config=Stack(**asked), weights=module.state_dict(), card={})
    return folder


def test_a_module_is_loaded_with_its_weights(tmp_path: Path) -> None:
    module = checkpoint.load(stored(tmp_path), Stack, stack)
    assert torch.equal(next(module.parameters()), checkpoint.read_weights(tmp_path)["0.weight"])


def test_no_random_values_are_drawn_for_weights_that_are_stored(tmp_path: Path) -> None:
    stored(tmp_path)
    before = torch.get_rng_state()
    checkpoint.load(tmp_path, Stack, stack)
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize(
    "asked", [{"layers": 10**9}, {"width": 10**5}, {"width": 10**9}, {"width": 10**21}, {"width": -1}]
)
def test_a_config_that_asks_for_more_than_there_is_is_refused_at_once(tmp_path: Path, asked: dict[str, int]) -> None:
    with pytest.raises(CheckpointError, match=r"config\.json describes no model of these weights"):
        checkpoint.load(stored(tmp_path, **asked), Stack, stack)


@pytest.mark.parametrize("name", ["config.json", "model.safetensors", "card.json"])
def test_a_pipe_in_place_of_a_file_is_refused_before_it_is_opened(tmp_path: Path, name: str) -> None:
    (stored(tmp_path) / name).unlink()
    os.mkfifo(tmp_path / name)
    read = read_card if name == "card.json" else lambda folder: checkpoint.load(folder, Stack, stack)
    with pytest.raises(CheckpointError, match="not a regular file"):
        read(tmp_path)


@pytest.mark.parametrize("text", ["[" * 100_000, "[]", "{"])
def test_a_card_that_is_no_table_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "card.json").write_text(text)
    with pytest.raises(CheckpointError, match="card"):
        read_card(tmp_path)


class SizeConfig(Config):
    width: int = 3


class Scale(Checkpointed):
    config_type = SizeConfig

    def __init__(self, config: SizeConfig) -> None:
        super().__init__()
        self.config = config
        self.factor = nn.Parameter(torch.zeros(config.width))


def test_a_saved_model_is_loaded_with_its_config_and_weights(tmp_path):
    model = Scale(SizeConfig(width=2))
    model.factor.data.fill_(0.1)
    model.save(tmp_path, {"licence": "Apache-2.0"}, dtype=torch.float16)
    loaded = Scale.load(tmp_path)
    assert (loaded.config, loaded.training, loaded.factor.dtype) == (model.config, False, torch.float32)
    torch.testing.assert_close(loaded.factor, model.factor, atol=1e-4, rtol=0)


def test_a_missing_file_is_named(tmp_path):
    Scale(SizeConfig()).save(tmp_path, {})
    (tmp_path / "model.safetensors").unlink()
    with pytest.raises(CheckpointError, match=r"model\.safetensors is missing"):
        Scale.load(tmp_path)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_no_numbers_are_refused_and_named(tmp_path: Path, value: float) -> None:
    write(tmp_path)
    weights = load_file(tmp_path / "model.safetensors")
    weights["bias"][1] = value
    save_file(weights, tmp_path / "model.safetensors")
    with pytest.raises(CheckpointError, match=r"model.safetensors is damaged \(bias holds what is no number"):
        checkpoint.read_weights(tmp_path)
