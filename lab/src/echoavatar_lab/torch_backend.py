"""What the avatar runs in torch, which it asks for by `echoavatar.nn.torch_backend`. May import `models` and below."""

from pathlib import Path
from typing import Any

import torch

from echoavatar.models.generator.config import GeneratorConfig, Precision
from echoavatar_lab.checkpoint import Checkpointed
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.nn.torch_step import TorchStep

PARTS: dict[str, type[Checkpointed]] = {
    "codec": AudioCodec,
    "tokenizer": BodyTokenizer,
    "generator": Generator,
    "face": FaceModel,
}


def load_part(name: str, folder: Path) -> Checkpointed:
    """The module of a part, one of `PARTS`. Raises CheckpointError if its files are damaged."""
    return PARTS[name].load(folder)


def open_step(module: Any, device: str, step: str, init_state: str) -> TorchStep:
    """A module's step and its fresh state, by their names, on a device."""
    there = module.to(device)
    return TorchStep(getattr(there, step), getattr(there, init_state), device)


def open_generator(module: Generator, device: str, precision: Precision) -> TorchStep:
    """The step of a generator in any order, with weights of a precision."""
    stream = open_stream(module.to(device), precision)
    return TorchStep(stream.step, stream.init_state, device)


def random_generator(config: GeneratorConfig) -> Generator:
    """A generator of random weights, ready for use."""
    return Generator(config).eval()


def devices() -> tuple[int, str]:
    """How many GPUs there are, and why none, if so."""
    if torch.cuda.is_available():
        return torch.cuda.device_count(), ""
    if torch.version.cuda is None:
        return 0, "this is torch's CPU build (pip install torch from the index of a CUDA build)"
    return 0, "no GPU, or no driver for it (see nvidia-smi)"


def describe() -> tuple[str, str]:
    """The version of torch, and the name of the GPU or nothing."""
    return torch.__version__, torch.cuda.get_device_name() if torch.cuda.is_available() else ""


def synchronize() -> None:
    """Wait until the GPU has done its work."""
    torch.cuda.synchronize()
