"""The motion quality reward: estimates how strongly motion was corrupted (paper, appendix). Network, training, tests.

    s = sigmoid(MLP(mean over time of TransformerEncoder(m)))

The encoder has the tokenizer's shape, attention at 30, 15 and 7.5 Hz with halvings between, but every frame sees the
whole clip and nothing is quantised. Besides the features it reads their first and second differences in time (ours):
corrupted motion jumps where true motion flows, and attention over poses alone learns that slowly. `differences` false
and `resampling` "dual" are the paper's. Trained with SmoothL1 on the scores of `corruption`, which `calibrate` measures
anew by FID. Every step's windows, levels and noise depend only on the seed and the step number. Held-out windows come
from clips of another split.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field
from scipy.stats import pearsonr, spearmanr
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.checkpoint import Checkpointed
from echoavatar_lab.data.feature_statistics import FeatureStatistics
from echoavatar_lab.evaluation.metrics.distributions import Moments, frechet_between, pooled
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder
from echoavatar_lab.models.generator.windows import TokenClip, WindowSampler, corrupt_hierarchically, corrupt_uniformly
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.nn.blocks import FullBlock, Mlp
from echoavatar_lab.training import Loss, TrainingConfig, TrainingTask, seeded

from .corruption import CLEAN, STRENGTHS, Corruption, Degradation, degraded, paper_scores
from .decoded_motion import DecodedMotion
from .probe import feature_moments
from .rewards import ReferenceStatistics

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


class QualityReward(Checkpointed):
    """Motion features in; a score from 0 (noise) to 1 (true motion) out."""

    config_type = QualityConfig

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

    @torch.no_grad()
    def judge(self, motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> float:
        """The score as a reward function."""
        return float(self(torch.from_numpy(motion.features)[None].float())[0])


def _with_differences(x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t d"]:
    """The features and their first and second differences; the first frame's differences are zero."""
    first = torch.diff(x, dim=1, prepend=x[:, :1])
    second = torch.diff(first, dim=1, prepend=first[:, :1])
    return torch.cat([x, PACE * first, PACE * second], -1)


WINDOW_CHUNKS = 15  # 4 s


class QualityTraining(TrainingConfig):
    """How the reward is trained."""

    steps: int = Field(default=1200, gt=0, description="optimiser steps")
    batch: int = Field(default=24, gt=0, description="windows a step")
    levels: int = Field(default=4, gt=0, description="corruption levels of one window in a batch")
    pool: int = Field(default=150, gt=0, description="decoded batches; later steps reuse them")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak; cosine to zero")
    warmup: int = Field(default=50, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(default=0.0, ge=0, le=1, description="share of the peak at the end")
    save_every: int = Field(default=100, ge=0, description="steps between checkpoints")


class CorruptedWindows:
    """Decoded windows at any level of corruption."""

    def __init__(
        self, tokenizer: BodyTokenizer, clips: Sequence[TokenClip], *, seed: int, chunks: int = WINDOW_CHUNKS
    ) -> None:
        self.tokenizer, self._seed = tokenizer, seed
        self._windows = WindowSampler(clips, chunks=chunks, seed=seed)

    def codes(self, number: int, size: int) -> Int[Tensor, "b n p q"]:
        """Clean windows of draw `number`."""
        return self._windows.batch(number, size).motion

    @torch.no_grad()
    def at(self, codes: Int[Tensor, "b n p q"], name: str, number: int) -> Float[Tensor, "b t c"]:
        """Features of windows at a level; the noise depends on seed, number and kind.

        All rates share the noise: a code corrupted at one rate is corrupted in the same way at every higher rate.
        """
        return self.tokenizer.decode(self._corrupted(codes, name, number))

    @torch.no_grad()
    def mixed(self, codes: Int[Tensor, "b n p q"], names: Sequence[str], number: int) -> Float[Tensor, "b t c"]:
        """Features of windows with a level for each row."""
        rows = [self._corrupted(codes[k : k + 1], name, number * 64 + k) for k, name in enumerate(names)]
        return self.tokenizer.decode(torch.cat(rows))

    def _corrupted(self, codes: Int[Tensor, "b n p q"], name: str, number: int) -> Int[Tensor, "b n p q"]:
        if name == CLEAN:
            return codes
        kind, _, rate = name.partition(" ")
        seed = (self._seed * 1_000_003 + number) * 2 + get_args(Corruption).index(kind)
        random = torch.Generator().manual_seed(seed)
        corrupt = corrupt_hierarchically if kind == "hierarchical" else corrupt_uniformly
        return corrupt(codes, float(rate), codebook=self.tokenizer.config.codes, generator=random)


def calibrate(levels: CorruptedWindows, encoder: MotionEncoder, *, windows: int = 64) -> dict[str, float]:
    """FID of each level against other clean windows, so that the clean level's own FID is not zero."""
    skeleton = levels.tokenizer.skeleton

    def at(name: str, first: int) -> Moments:
        found: list[Moments] = []
        for number in range(first, first + math.ceil(windows / 16)):
            features = levels.at(levels.codes(number, 16), name, number)
            found += feature_moments(encoder, skeleton, features)
        return pooled(found)

    true = at(CLEAN, 10_000)
    return {name: frechet_between(at(name, 0), true) for name in paper_scores()}


class ScoredWindows(NamedTuple):
    """Windows and their target scores."""

    features: Float[Tensor, "b t c"]
    scores: Float[Tensor, " b"]


class QualityTask(TrainingTask[ScoredWindows]):
    """The training task of the quality reward."""

    kind = "quality_reward"
    config: QualityTraining

    def __init__(
        self,
        levels: CorruptedWindows,
        config: QualityConfig,
        training: QualityTraining,
        scores: Mapping[str, float] | None = None,
        card: Mapping[str, object] | None = None,
    ) -> None:
        """`scores` of levels are the paper's where none are given."""
        with seeded(training.seed):
            self.model = QualityReward(config)
        self.model.set_statistics(levels.tokenizer.statistics)
        super().__init__(training, {"model": self.model}, card)
        self._levels, self._scores = levels, dict(scores or paper_scores())
        self._pool: dict[int, ScoredWindows] = {}

    def draw(self, step: int) -> ScoredWindows:
        """See `TrainingTask.draw`; each batch is decoded once."""
        number = step % self.config.pool
        if number not in self._pool:
            made = self._decoded_batch(number)
            self._pool[number] = ScoredWindows(made.features.half(), made.scores)
        found = self._pool[number]
        return ScoredWindows(found.features.float(), found.scores)

    def _decoded_batch(self, number: int) -> ScoredWindows:
        training, names = self.config, list(self._scores)
        random = np.random.default_rng([training.seed, number])
        windows = math.ceil(training.batch / training.levels)
        codes = self._levels.codes(number, windows).repeat_interleave(training.levels, 0)[: training.batch]
        asked = [names[int(k)] for _ in range(windows) for k in random.permutation(len(names))[: training.levels]]
        asked = asked[: training.batch]
        features = self._levels.mixed(codes, asked, number)
        return ScoredWindows(features, torch.tensor([self._scores[name] for name in asked]))

    def loss(self, batch: ScoredWindows, step: int) -> Loss:
        """SmoothL1 with a small quadratic region, because scores lie between 0 and 1."""
        made = self.model(batch.features)
        error = (made - batch.scores).abs().mean()
        return Loss(F.smooth_l1_loss(made, batch.scores, beta=0.1), {"error": error})

    def card(self, step: int) -> dict[str, object]:
        """The card, with the scores of the levels."""
        return super().card(step) | {"scores": self._scores}


@torch.no_grad()
def measure_quality(
    model: QualityReward, levels: CorruptedWindows, scores: Mapping[str, float], *, windows: int = 32
) -> dict[str, object]:
    """Correlation with the assigned scores on held-out windows, means by level, rank order on unseen degradations.

    Pearson is computed over levels (each level's mean against its score, as in the paper's figure) and over windows.
    `is_ordered` tells for each kind whether the means fall from rate to rate.
    """
    clean = levels.codes(0, windows)
    by_level = {name: model(levels.at(clean, name, 0)) for name in scores}
    means = {name: float(found.mean()) for name, found in by_level.items()}
    wanted = np.array([scores[name] for name in by_level])
    single = np.concatenate([found.numpy() for found in by_level.values()])
    result: dict[str, object] = {
        "pearson_levels": float(pearsonr(wanted, [means[name] for name in by_level])[0]),
        "pearson_windows": float(pearsonr(np.repeat(wanted, windows), single)[0]),
        "spearman_windows": float(spearmanr(np.repeat(wanted, windows), single)[0]),
        "is_ordered": {kind: bool((np.diff(_course(means, kind)[1]) < 0).all()) for kind in get_args(Corruption)},
        "levels": means,
    }
    unseen, motion = {}, levels.tokenizer.decode(clean)
    for other in get_args(Degradation):
        found = [model(degraded(motion, other, s, levels.tokenizer.skeleton)).numpy() for s in STRENGTHS]
        severity = np.repeat(STRENGTHS, windows)
        unseen[other] = {
            "spearman": float(spearmanr(severity, np.concatenate(found))[0]),
            "means": [float(one.mean()) for one in found],
        }
    return result | {"unseen": unseen, "windows": windows}


def _course(levels: Mapping[str, float], kind: str) -> tuple[list[float], list[float]]:
    """Severities of a kind with the clean level as 0, and the value of each."""
    found = {float(name.split()[1]): value for name, value in levels.items() if name.split()[0] == kind}
    return [0.0, *sorted(found)], [levels[CLEAN], *(found[rate] for rate in sorted(found))]


def draw_quality(found: Mapping[str, object], scores: Mapping[str, float], path: Path) -> None:
    """The paper's figure: mean score over severity, measured and assigned, for trained and unseen kinds."""
    from matplotlib.figure import Figure  # slow to import

    from echoavatar_lab.training.curves import save_figure

    means, unseen = found["levels"], found["unseen"]
    assert isinstance(means, dict)
    assert isinstance(unseen, dict)
    kinds = get_args(Corruption)
    figure = Figure(figsize=(4 * len(kinds) + 4, 3.6))
    axes = figure.subplots(1, len(kinds) + 1, sharey=True)
    for axis, kind in zip(axes, kinds, strict=False):
        axis.plot(*_course(scores, kind), "--", color="0.5", label="assigned")
        axis.plot(*_course(means, kind), "o-", label="reward")
        axis.set_title(f"{kind} (trained on)")
        axis.legend()
    for kind, one in unseen.items():
        axes[-1].plot(STRENGTHS, one["means"], "o-", label=kind)
    axes[-1].set_title("never trained on")
    axes[-1].legend()
    for axis in axes:
        axis.set_xlabel("severity")
    axes[0].set_ylabel("quality reward, held-out")
    figure.tight_layout()
    save_figure(figure, path, dpi=120)
