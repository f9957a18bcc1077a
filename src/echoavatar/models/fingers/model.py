"""The finger model: a transformer that sees a whole window and predicts clean hands from noisy ones.

Paper, Motion Refinement: a motion inpainting model synthesises finger motion conditioned on the remaining body joints.
In the input, known hands are given and flagged; unknown hands are noise.
"""

import math
from collections.abc import Mapping
from importlib.resources import as_file, files
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar.nn import Checkpointed, FullBlock, Mlp

from .body_features import BODY_SIZE
from .config import FingerConfig
from .hand_poses import HAND_SIZE, HandBasis

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

    def save(self, folder: Path, card: Mapping[str, object], *, dtype: torch.dtype | None = torch.float16) -> None:
        """Write a checkpoint folder, in half precision."""
        super().save(folder, card, dtype=dtype)

    @property
    def basis(self) -> HandBasis:
        """The basis of hand coordinates."""
        return HandBasis(self.hand_mean, self.hand_axes, self.hand_scale)

    def set_statistics(self, basis: HandBasis, body_mean: Float[Tensor, " c"], body_std: Float[Tensor, " c"]) -> None:
        """Set the statistics of the training clips."""
        pairs = zip((self.hand_mean, self.hand_axes, self.hand_scale), basis, strict=True)
        for own, given in [*pairs, (self.body_mean, body_mean), (self.body_std, body_std)]:
            own.copy_(given)

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
    with as_file(files("echoavatar") / "bundles" / "fingers") as folder:
        return FingerModel.load(folder)


def _waves(level: Float[Tensor, " b"]) -> Float[Tensor, "b c"]:
    rates = torch.arange(1, _LEVEL_WAVES + 1, device=level.device) * math.pi / 2
    angles = level[:, None] * rates
    return torch.cat([angles.sin(), angles.cos()], -1)
