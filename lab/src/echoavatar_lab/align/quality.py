"""The motion quality reward: estimates how strongly motion was corrupted (paper, appendix).

    s = sigmoid(MLP(mean over time of TransformerEncoder(m)))

The encoder has the tokenizer's shape, attention at 30, 15 and 7.5 Hz with halvings between, but every frame sees the
whole clip and nothing is quantised. Besides the features it reads their first and second differences in time (ours):
corrupted motion jumps where true motion flows, and attention over poses alone learns that slowly. `differences` false
and `resampling` "dual" are the paper's. Trained with SmoothL1
on the scores of `corruption` (`quality_train`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, Self

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from echoavatar import checkpoint
from echoavatar.config import Config
from echoavatar.motion.kinematics import FeatureStatistics
from echoavatar.nn import FullBlock, Mlp
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN

from .decoded_motion import DecodedMotion
from .reference_statistics import ReferenceStatistics

PACE = 5.0  # scales the differences so that those of true motion are about as large as the features
LEVELS = FRAMES_PER_MOTION_TOKEN.bit_length()


class QualityConfig(Config):
    """Model sizes; the paper uses those of its tokenizer (width 512, 8 heads)."""

    features: int = Field(default=315, gt=0, description="channels of the motion features")
    width: int = Field(default=96, gt=0, description="channels (paper: 512)")
    heads: int = Field(default=4, gt=0, description="attention heads (paper: 8)")
    blocks: int = Field(default=1, gt=0, description="attention blocks a level")
    resampling: Literal["learned", "dual"] = Field(
        default="learned", description="between levels: the MLP alone, or mean and MLP (the paper's dual path)"
    )
    differences: bool = Field(default=True, description="whether differences in time are read too (paper: false)")


class QualityReward(nn.Module):
    """Motion features in; a score from 0 (noise) to 1 (true motion) out."""

    mean: Tensor
    std: Tensor
    varies: Tensor

    def __init__(self, config: QualityConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.input = nn.Linear((3 if config.differences else 1) * config.features, width)
        self.levels = nn.ModuleList(
            nn.Sequential(*(FullBlock(width=width, heads=config.heads) for _ in range(config.blocks)))
            for _ in range(LEVELS)
        )
        self.down = nn.ModuleList(Mlp(inputs=2 * width, hidden=4 * width, outputs=width) for _ in range(LEVELS - 1))
        self.head = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.GELU(), nn.Linear(width, 1))
        self.register_buffer("mean", torch.zeros(config.features))
        self.register_buffer("std", torch.ones(config.features))
        self.register_buffer("varies", torch.ones(config.features, dtype=torch.bool))

    @torch.no_grad()
    def set_statistics(self, statistics: FeatureStatistics) -> None:
        """Normalise like the tokenizer."""
        for own, value in zip((self.mean, self.std, self.varies), statistics, strict=True):
            own.copy_(value)

    def forward(self, features: Float[Tensor, "b t c"]) -> Float[Tensor, " b"]:
        """Scores of clips whose length is a multiple of four frames; features are not normalised yet."""
        x = FeatureStatistics(self.mean, self.std, self.varies).normalize(features)
        x = self.input(_with_differences(x) if self.config.differences else x)
        for level, blocks in enumerate(self.levels):
            x = blocks(x)
            if level < LEVELS - 1:
                pairs = x.view(x.shape[0], x.shape[1] // 2, -1)
                is_dual = self.config.resampling == "dual"
                x = self.down[level](pairs) + (pairs.unflatten(2, (2, -1)).mean(2) if is_dual else 0)
        y: Tensor = torch.sigmoid(self.head(x.mean(1)))
        return y[:, 0]

    def save(self, folder: Path, card: Mapping[str, object]) -> None:
        """Write a checkpoint folder."""
        checkpoint.save(folder, config=self.config, weights=self.state_dict(), card=card)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a checkpoint folder.

        Raises:
            CheckpointError: the folder holds no quality reward.
        """
        return checkpoint.load(folder, QualityConfig, cls).eval()

    @torch.no_grad()
    def judge(self, motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> float:
        """The score as a reward function."""
        return float(self(torch.from_numpy(motion.features)[None].float())[0])


def _with_differences(x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t d"]:
    """The features and their first and second differences; the first frame's differences are zero."""
    first = torch.diff(x, dim=1, prepend=x[:, :1])
    second = torch.diff(first, dim=1, prepend=first[:, :1])
    return torch.cat([x, PACE * first, PACE * second], -1)
