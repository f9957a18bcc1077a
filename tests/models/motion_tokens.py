"""Small bodies and smooth made-up motion for the tokenizer's tests."""

from types import SimpleNamespace

import torch

from echoavatar.models.tokenizer_config import BodyTokenizerConfig, MotionTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle
from echoavatar_lab.models.quantize import ResidualVectorQuantizer
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import body_config


def small_config(width: int = 16) -> BodyTokenizerConfig:
    template = MotionTokenizerConfig(
        features=1, width=width, heads=2, layers=2, codes=16, dead_below=0.02, kmeans_steps=2
    )
    return body_config(HUMANOID, template)


def small_body(seed: int = 0) -> BodyTokenizer:
    torch.manual_seed(seed)
    body = BodyTokenizer(small_config())
    for part in body.tokenizers().values():
        fill(part.quantizer)
    body.mean.normal_(0, 0.3)
    body.std.uniform_(0.1, 1.0)
    return body.eval()


def fill(quantizer: ResidualVectorQuantizer) -> None:
    for book in quantizer.books():
        torch.nn.init.normal_(book.codebook)


def dance(seed: int, frames: int = 160) -> SimpleNamespace:
    """Every joint swings in a few slow sines; the root sways and steps."""
    generator = torch.Generator().manual_seed(seed)
    mix = torch.randn(6, 52 * 3, generator=torch.Generator().manual_seed(1)) * 0.1
    time = torch.arange(frames)[:, None] / 30
    waves = torch.sin(time * (1 + 5 * torch.rand(6, generator=generator)) + 6 * torch.rand(6, generator=generator))
    rotations = quaternion_from_axis_angle((waves @ mix).view(frames, 52, 3).numpy())
    root = torch.stack([0.1 * waves[:, 0], 0.93 + 0.02 * waves[:, 1], 0.1 * waves[:, 2]], -1)
    return SimpleNamespace(rotations=rotations, root=root.numpy())
