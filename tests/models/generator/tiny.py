"""Generators of a few thousand numbers, with weights large enough that every input matters."""

import torch

from echoavatar.models.generator import GeneratorConfig
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout

LAYOUT = compact_layout(audio_codes=16, motion_layers=2, motion_codes=8)


def config(**changes) -> GeneratorConfig:
    sizes = {
        "layout": LAYOUT,
        "width": 32,
        "layers": 2,
        "heads": 4,
        "kv_heads": 2,
        "mlp": 48,
        "window_chunks": 3,
        "depth_width": 24,
        "depth_layers": 2,
        "depth_heads": 2,
    }
    return GeneratorConfig(**(sizes | changes))


def generator(seed: int = 0, **changes) -> Generator:
    model = Generator(config(**changes)).eval()
    random = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=random) * 0.3)
    return model


def audio(rows: int, frames: int, seed: torch.Generator | int = 0) -> torch.Tensor:
    random = torch.Generator().manual_seed(seed) if isinstance(seed, int) else seed
    return torch.randint(16, (rows, frames, 2), generator=random)
