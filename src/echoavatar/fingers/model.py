"""The finger model: a transformer that sees a window whole and says what the hands behind the noise are.

Paper, Motion Refinement: a motion inpainting model synthesises finger motion conditioned on the remaining body joints.
Hands that are known stand in the input as they are and are flagged; unknown ones stand there as noise.
"""

import math
from collections.abc import Mapping
from importlib.resources import as_file, files
from pathlib import Path
from typing import Self

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from .. import checkpoint
from ..nn.attention import rotary, rotary_table
from ..nn.blocks import Mlp
from .body import BODY_SIZE
from .config import FingerConfig
from .hands import HAND_SIZE, HandBasis

_LEVEL_WAVES = 16
_BODY_LIMIT = 4.0  # spreads: a body beyond anything seen in training is taken for one at the limit
_LEAST_SPREAD = 0.02


class WindowBlock(nn.Module):
    """x + Attention(norm(x)), then x + MLP(norm(x)); every token sees every other (rotary positions)."""

    def __init__(self, *, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width, bias=False)
        self.proj = nn.Linear(width, width)
        self.mlp = Mlp(inputs=width, hidden=4 * width, outputs=width)

    def forward(self, x: Float[Tensor, "b n c"], table: Float[Tensor, "2 n d"]) -> Float[Tensor, "b n c"]:
        """Any number of tokens; `table` holds their rotary angles."""
        b, n, _ = x.shape
        q, k, v = self.qkv(self.norm1(x)).view(b, n, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        seen = F.scaled_dot_product_attention(rotary(q, table), rotary(k, table), v)
        x = x + self.proj(seen.transpose(1, 2).flatten(2))
        y: Tensor = x + self.mlp(self.norm2(x))
        return y


class FingerModel(nn.Module):
    """Weights, the hand basis and the body statistics; `sample_hands` runs it over whole clips."""

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
        self.blocks = nn.ModuleList(
            WindowBlock(width=config.width, heads=config.heads) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(config.width)
        self.out = nn.Linear(config.width, config.patch * 2 * config.poses)
        self.register_buffer("hand_mean", torch.zeros(HAND_SIZE))
        self.register_buffer("hand_axes", torch.eye(config.poses, HAND_SIZE))
        self.register_buffer("hand_scale", torch.ones(config.poses))
        self.register_buffer("body_mean", torch.zeros(BODY_SIZE))
        self.register_buffer("body_std", torch.ones(BODY_SIZE))

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a checkpoint folder.

        Raises:
            CheckpointError: something is missing or does not fit.
        """
        return checkpoint.load(folder, FingerConfig, cls).eval()

    def save(self, folder: Path, card: Mapping[str, object]) -> None:
        """Write a checkpoint folder, in half precision."""
        checkpoint.save(folder, config=self.config, weights=self.state_dict(), card=card, dtype=torch.float16)

    @property
    def basis(self) -> HandBasis:
        """How hands are written as coordinates."""
        return HandBasis(self.hand_mean, self.hand_axes, self.hand_scale)

    def measure(
        self, basis: HandBasis, body_mean: Float[Tensor, " c"], body_std: Float[Tensor, " c"]
    ) -> None:
        """Take over the statistics of the training clips."""
        pairs = zip((self.hand_mean, self.hand_axes, self.hand_scale), basis, strict=True)
        for own, given in [*pairs, (self.body_mean, body_mean), (self.body_std, body_std)]:
            own.copy_(given)

    def normalize_body(self, body: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
        """Zero mean, unit spread, nothing beyond the limit."""
        spread = self.body_std.clamp_min(_LEAST_SPREAD)
        return ((body - self.body_mean) / spread).clamp(-_BODY_LIMIT, _BODY_LIMIT)

    def forward(
        self,
        hands: Float[Tensor, "b t 2 k"],
        is_known: Bool[Tensor, "b t 2"],
        level: Float[Tensor, " b"],
        body: Float[Tensor, "b t c"],
    ) -> Float[Tensor, "b t 2 k"]:
        """Clean hands.

        Args:
            hands: coordinates; unknown ones are (1 - level) clean + level noise.
            is_known: which hands stand there clean.
            level: how much of the unknown is noise, 0 to 1.
            body: normalised features of the same frames.
        """
        frames = torch.cat([hands.flatten(2), is_known.to(hands), body], -1)
        b, t, _ = frames.shape
        x = self.embed(frames.reshape(b, t // self.config.patch, -1))
        x = x + self.level(_waves(level))[:, None]
        table = rotary_table(x.shape[1], self.config.width // self.config.heads).to(x)
        for block in self.blocks:
            x = block(x, table)
        y: Tensor = self.out(self.norm(x))
        return y.reshape(b, t, 2, -1)


def load_shipped() -> FingerModel:
    """The model that comes with the package."""
    with as_file(files("echoavatar") / "bundles" / "fingers") as folder:
        return FingerModel.load(folder)


def _waves(level: Float[Tensor, " b"]) -> Float[Tensor, "b c"]:
    rates = torch.arange(1, _LEVEL_WAVES + 1, device=level.device) * math.pi / 2
    angles = level[:, None] * rates
    return torch.cat([angles.sin(), angles.cos()], -1)
