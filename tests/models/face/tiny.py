"""A face model of a few hundred weights, and its stream as the laws want it."""

import numpy as np
import torch

from echoavatar.models.face import FaceConfig, FaceState, MelConfig
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar_lab.models.face.clip import FaceClip
from echoavatar_lab.models.face.model import FaceModel

JAW = ARKIT_NAMES.index("jawOpen")
EAR = MelConfig(bands=8, windows=2, width=8, blocks=2, past=3)
CONFIG = FaceConfig(
    encoder=EAR,
    channels=52,
    width=16,
    layers=2,
    heads=2,
    context=12,
    condition=8,
    head_width=16,
    head_blocks=2,
    noise_hold=4,
)


def make(config: FaceConfig = CONFIG) -> FaceModel:
    torch.manual_seed(0)
    model = FaceModel(config).double().eval()
    for parameter in model.parameters():  # wide enough that sound and noise make a difference
        if parameter.dim() > 1:
            parameter.data.mul_(1.5)
    model.mean.fill_(0.5)
    model.std.fill_(0.1)
    return model


class Seeded:
    """A stream whose seeds follow from the row's number."""

    def __init__(self, model: FaceModel) -> None:
        self.stream = model.stream()

    def init_state(self, rows: int) -> FaceState:
        return self.stream.init_state(rows)

    def step(self, x: torch.Tensor, state: FaceState, active: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(self.stream.step(x.numpy(), state, active.numpy(), 100 + np.arange(len(x))))

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        return self.step(x, self.init_state(len(x)), torch.ones(len(x), dtype=torch.bool))


def sound(rows: int, samples: int, generator: torch.Generator) -> torch.Tensor:
    """Noise whose loudness changes from chunk to chunk."""
    loud = torch.rand(rows, samples // CHUNK_SAMPLES, 1, generator=generator).double()
    noise = torch.randn(rows, samples, generator=generator).double()
    return 0.3 * (noise.unflatten(1, (-1, CHUNK_SAMPLES)) * loud).flatten(1)


def clip(frames: int = 160, seed: int = 0, split: str = "train") -> FaceClip:
    """The jaw follows the loudness of noise, which changes every 12 frames."""
    rng = np.random.default_rng(seed)
    jaw = np.repeat(rng.choice([0.0, 0.5], frames // 12 + 1), 12)[:frames].astype(np.float32)
    audio = np.repeat(jaw, 800) * rng.normal(0, 0.4, frames * 800)
    curves = np.zeros((frames, 52), np.float32)
    curves[:, JAW] = jaw
    return FaceClip(f"c{seed}", audio.clip(-1, 1).astype(np.float32), curves, split)
