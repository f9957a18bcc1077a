"""What the avatar gets through its door."""

import inspect
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.models.generator.tiny import audio, config, generator

from echoavatar.errors import CheckpointError
from echoavatar.nn.torch_backend import TorchBackend
from echoavatar_lab import torch_backend
from echoavatar_lab.models.generator.stream import open_stream


def test_it_offers_what_the_avatar_asks_for() -> None:
    asked = {name: each for name, each in vars(TorchBackend).items() if inspect.isfunction(each) and name[0] != "_"}
    assert len(asked) == 7
    for name, each in asked.items():
        own = inspect.signature(getattr(torch_backend, name))
        assert ["self", *own.parameters] == list(inspect.signature(each).parameters), name


def test_parts_are_loaded_by_name(tiny_bundle: Path, tmp_path: Path) -> None:
    for name in ("codec", "tokenizer", "generator"):
        part = torch_backend.load_part(name, tiny_bundle / name)
        assert type(part) is torch_backend.PARTS[name]
        assert not part.training
    with pytest.raises(CheckpointError):
        torch_backend.load_part("face", tmp_path)


def test_a_step_takes_and_gives_arrays(tiny_bundle: Path) -> None:
    tokenizer = torch_backend.load_part("tokenizer", tiny_bundle / "tokenizer")
    step = torch_backend.open_step(tokenizer, "cpu", "decode_step", "init_decoder")
    codes = np.random.default_rng(0).integers(8, size=(1, 2, 3, 2))
    made = step.step(codes, step.init_state(1), np.ones(1, np.bool_))
    np.testing.assert_allclose(made, tokenizer.decode(torch.from_numpy(codes)).numpy(), atol=1e-6)


@torch.no_grad()
def test_a_generator_runs_as_its_own_stream() -> None:
    model, seeds = generator(sequence="prefix"), np.zeros(1, np.int64)
    opened, stream = torch_backend.open_generator(model, "cpu", "float32"), open_stream(model, "float32")
    sound, everyone = audio(1, 20), torch.ones(1, dtype=torch.bool)
    wanted = stream.step(sound, stream.init_state(1), everyone, seeds=torch.from_numpy(seeds))
    made = opened.step(sound.numpy(), opened.init_state(1), everyone.numpy(), seeds=seeds)
    assert np.array_equal(made, wanted.numpy())


def test_a_generator_of_random_weights_has_the_sizes_that_are_asked_for() -> None:
    sizes = config(sequence="depth")
    made = torch_backend.random_generator(sizes)
    assert made.config == sizes
    assert not made.training


def test_it_says_which_devices_there_are() -> None:
    count, why_none = torch_backend.devices()
    version, name = torch_backend.describe()
    assert version == torch.__version__
    assert (count > 0) == (why_none == "") == bool(name) == torch.cuda.is_available()
