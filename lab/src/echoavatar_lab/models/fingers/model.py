"""The finger model: a transformer that sees a whole window and predicts clean hands from noisy ones.

Paper, Motion Refinement: a motion inpainting model synthesises finger motion conditioned on the remaining body joints.
In the input, known hands are given and flagged; unknown hands are noise. The paper gives no sizes.

Clips of any length are denoised in overlapping windows (`sample_hands`). All windows read the same noisy clip, and
their outputs are averaged before the next step, so no seams appear.
"""

import math
from collections.abc import Callable
from importlib.resources import as_file, files
from typing import Self

import torch
from jaxtyping import Bool, Float
from pydantic import Field, model_validator
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar_lab.checkpoint import Checkpointed
from echoavatar_lab.models.fingers.clips import BODY_SIZE, HAND_SIZE, HandBasis
from echoavatar_lab.nn.blocks import FullBlock, Mlp


class FingerConfig(Config):
    """A small transformer without causal mask."""

    frames: int = Field(default=64, gt=0, le=4096, description="frames of a window, at 30 per second")
    patch: int = Field(default=4, gt=0, le=4096, description="frames that share a token; must divide the window")
    width: int = Field(default=128, gt=0, description="channels")
    layers: int = Field(default=3, gt=0, description="transformer blocks")
    heads: int = Field(default=4, gt=0, description="attention heads")
    poses: int = Field(default=24, gt=0, le=HAND_SIZE, description="principal directions of one hand's pose")

    @model_validator(mode="after")
    def _sizes_fit(self) -> Self:
        if self.frames % self.patch:
            raise ValueError(f"patch ({self.patch}) must divide frames ({self.frames})")
        if self.width % (2 * self.heads):
            raise ValueError(f"width ({self.width}) must be a multiple of twice the heads ({self.heads})")
        return self


_LEVEL_WAVES = 16
_BODY_LIMIT = 4.0  # standard deviations at which body features are clamped
_LEAST_SPREAD = 0.02


class FingerModel(Checkpointed):
    """Weights, hand basis and body statistics; `sample_hands` runs it over whole clips."""

    config_type = FingerConfig
    config: FingerConfig
    hand_mean: Tensor
    hand_axes: Tensor
    hand_scale: Tensor
    body_mean: Tensor
    body_std: Tensor

    def __init__(self, config: FingerConfig) -> None:
        super().__init__()
        self.config = config
        frame = 2 * config.poses + 2 + BODY_SIZE
        self.embed = nn.Linear(config.patch * frame, config.width)
        self.level = Mlp(inputs=2 * _LEVEL_WAVES, hidden=config.width, outputs=config.width)
        self.blocks = nn.ModuleList(FullBlock(width=config.width, heads=config.heads) for _ in range(config.layers))
        self.norm = nn.LayerNorm(config.width)
        self.out = nn.Linear(config.width, config.patch * 2 * config.poses)
        self.register_buffer("hand_mean", torch.zeros(HAND_SIZE))
        self.register_buffer("hand_axes", torch.eye(config.poses, HAND_SIZE))
        self.register_buffer("hand_scale", torch.ones(config.poses))
        self.register_buffer("body_mean", torch.zeros(BODY_SIZE))
        self.register_buffer("body_std", torch.ones(BODY_SIZE))

    @property
    def basis(self) -> HandBasis:
        """The basis of hand coordinates."""
        return HandBasis(self.hand_mean, self.hand_axes, self.hand_scale)

    def normalize_body(self, body: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
        """Normalise to zero mean and unit deviation, and clamp."""
        spread = self.body_std.clamp_min(_LEAST_SPREAD)
        return ((body - self.body_mean) / spread).clamp(-_BODY_LIMIT, _BODY_LIMIT)

    def forward(
        self,
        hands: Float[Tensor, "b t 2 k"],
        is_known: Bool[Tensor, "b t 2"],
        level: Float[Tensor, " b"],
        body: Float[Tensor, "b t c"],
    ) -> Float[Tensor, "b t 2 k"]:
        """Predict clean hands.

        Args:
            hands: coordinates; unknown ones are (1 - level) clean + level noise.
            is_known: which hands are given clean.
            level: share of noise in unknown hands, 0 to 1.
            body: normalised features of the same frames.
        """
        frames = torch.cat([hands.flatten(2), is_known.to(hands), body], -1)
        b, t, _ = frames.shape
        x = self.embed(frames.reshape(b, t // self.config.patch, -1))
        x = x + self.level(_waves(level))[:, None]
        for block in self.blocks:
            x = block(x)
        y: Tensor = self.out(self.norm(x))
        return y.reshape(b, t, 2, -1)


def load_shipped() -> FingerModel:
    """The model that ships with the package."""
    with as_file(files("echoavatar_lab") / "bundles" / "fingers") as folder:
        return FingerModel.load(folder)


def _waves(level: Float[Tensor, " b"]) -> Float[Tensor, "b c"]:
    rates = torch.arange(1, _LEVEL_WAVES + 1, device=level.device) * math.pi / 2
    angles = level[:, None] * rates
    return torch.cat([angles.sin(), angles.cos()], -1)


STEPS = 8
_ROWS = 32  # windows in one call of the model
_LIMIT = 4.0  # standard deviations at which a coordinate is clamped


@torch.inference_mode()
def sample_hands(
    model: FingerModel,
    body: Float[Tensor, "t c"],
    known: Float[Tensor, "t 2 k"],
    is_known: Bool[Tensor, "t 2"],
    *,
    seed: int = 0,
    steps: int = STEPS,
    progress: Callable[[int, int], None] | None = None,
) -> Float[Tensor, "t 2 k"]:
    """Coordinates of both hands; known hands are returned unchanged.

    Args:
        model: a trained finger model.
        body: features of the clip (`body_features`), not normalised.
        known: coordinates of the kept hands; other entries are ignored.
        is_known: which hands are kept in each frame.
        seed: of the noise; another seed gives other hands.
        steps: of denoising; 1 gives the mean of all plausible hands, more steps give a sample.
        progress: called with (steps done, steps).
    """
    frames, count = model.config.frames, len(body)
    random = torch.Generator().manual_seed(seed)
    hands = torch.randn(known.shape, generator=random)
    index = _windows(count, frames, model.config.patch)
    weight = torch.sin((torch.arange(frames) + 0.5) / frames * torch.pi).square()
    normal = model.normalize_body(body)[index]
    kept, clean = is_known[..., None], hands
    for step in range(steps):
        level, after = 1 - step / steps, 1 - (step + 1) / steps
        seen = torch.where(kept, known, hands)
        clean = _blend(model, seen, is_known, level, normal, index, weight)
        noise = (hands - (1 - level) * clean) / level
        hands = (1 - after) * clean + after * noise
        if progress is not None:
            progress(step + 1, steps)
    return torch.where(kept, known, clean)


def _windows(count: int, frames: int, patch: int) -> Tensor:
    """Frames of each window (w, frames): about half overlapping; a short clip repeats its last frame.

    The stride is no multiple of a token, so token borders of neighbouring windows do not coincide.
    """
    stride = max(1, frames // 2 - patch // 2)
    starts = [*range(0, max(1, count - frames), stride), max(0, count - frames)]
    unique = torch.tensor(sorted(set(starts)))
    return (unique[:, None] + torch.arange(frames)).clamp(max=count - 1)


def _blend(
    model: FingerModel, hands: Tensor, is_known: Tensor, level: float, body: Tensor, index: Tensor, weight: Tensor
) -> Tensor:
    total, share = torch.zeros_like(hands), torch.zeros(len(hands))
    for first in range(0, len(index), _ROWS):
        at = index[first : first + _ROWS]
        levels = torch.full((len(at),), level)
        clean = model(hands[at], is_known[at], levels, body[first : first + _ROWS])
        total.index_add_(0, at.flatten(), (clean * weight[:, None, None]).flatten(0, 1))
        share.index_add_(0, at.flatten(), weight.repeat(len(at)))
    limit = _LIMIT * model.basis.spread
    mean = total / share[:, None, None]
    return torch.maximum(torch.minimum(mean, limit), -limit)
