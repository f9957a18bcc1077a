"""Training and testing the quality reward on token clips, and calibrating scores by FID.

Every step's windows, levels and noise follow from the seed and the step's number. Held-out windows come from clips of
another split.
"""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import get_args

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field
from scipy.stats import pearsonr, spearmanr
from torch import Tensor

from ..config import Config
from ..generator import TokenClip, WindowSampler
from ..kinematics import from_features
from ..kinematics.rotations import quaternion_from_matrix
from ..metrics.frechet import Moments, frechet_between, moments, pooled
from ..metrics.motion_encoder import MotionEncoder
from ..metrics.motion_features import motion_features
from ..tokenizer import BodyTokenizer
from .degrade import CLEAN, RATES, Kind, Unseen, corrupted, level_name, paper_scores, spoiled
from .quality import QualityConfig, QualityReward

WINDOW_CHUNKS = 15  # 4 s
STRENGTHS = (0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)


class QualityTraining(Config):
    """How the reward is trained."""

    steps: int = Field(default=600, gt=0, description="optimiser steps")
    batch: int = Field(default=16, gt=0, description="windows a step")
    pool: int = Field(default=150, gt=0, description="batches decoded; later steps see them again")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak; cosine to zero")
    seed: int = Field(default=0, description="of weights, windows, levels and noise")


class Levels:
    """Decoded windows at any level of corruption."""

    def __init__(self, tokenizer: BodyTokenizer, clips: Sequence[TokenClip], *, seed: int) -> None:
        self.tokenizer, self._seed = tokenizer, seed
        self._windows = WindowSampler(clips, chunks=WINDOW_CHUNKS, seed=seed)

    def codes(self, number: int, size: int) -> Int[Tensor, "b n p q"]:
        """Clean windows of a number."""
        return self._windows.batch(number, size).motion

    @torch.no_grad()
    def at(self, codes: Int[Tensor, "b n p q"], name: str, number: int) -> Float[Tensor, "b t c"]:
        """Features of windows at a level; the noise depends on seed, number and level."""
        return self.tokenizer.decode(self._spoil(codes, name, number))

    @torch.no_grad()
    def mixed(
        self, codes: Int[Tensor, "b n p q"], names: Sequence[str], number: int
    ) -> Float[Tensor, "b t c"]:
        """The same with a level for each row."""
        rows = [self._spoil(codes[k : k + 1], name, number * 64 + k) for k, name in enumerate(names)]
        return self.tokenizer.decode(torch.cat(rows))

    def _spoil(self, codes: Int[Tensor, "b n p q"], name: str, number: int) -> Int[Tensor, "b n p q"]:
        if name == CLEAN:
            return codes
        level = paper_levels().index(name)
        random = torch.Generator().manual_seed((self._seed * 1_000_003 + number) * 64 + level)
        which: Kind = "uniform" if name.startswith("uniform") else "hierarchical"
        rate = float(name.split()[1])
        return corrupted(codes, which, rate, codebook=self.tokenizer.config.codes, generator=random)


def paper_levels() -> list[str]:
    """All levels that codes can be brought to."""
    return [CLEAN, *(level_name(kind, rate) for kind in get_args(Kind) for rate in RATES)]


def calibrate(levels: Levels, encoder: MotionEncoder, *, windows: int = 64) -> dict[str, float]:
    """FID of each level against clean windows of other places (so that the clean level's own is not zero)."""
    skeleton = levels.tokenizer.skeleton

    def measured(features: Float[Tensor, "b t c"]) -> list[Moments]:
        moved = from_features(skeleton, features)
        turns = quaternion_from_matrix(moved.rotations)
        clips = [motion_features(turn, root) for turn, root in zip(turns, moved.root, strict=True)]
        return [moments(encoder.features(clip).numpy()) for clip in clips]

    def at(name: str, first: int) -> Moments:
        found: list[Moments] = []
        for number in range(first, first + math.ceil(windows / 16)):
            found += measured(levels.at(levels.codes(number, 16), name, number))
        return pooled(found)

    true = at(CLEAN, 10_000)
    return {name: frechet_between(at(name, 0), true) for name in paper_levels()}


def train_quality(
    levels: Levels,
    folder: Path,
    training: QualityTraining,
    *,
    config: QualityConfig | None = None,
    scores: Mapping[str, float] | None = None,
    card: Mapping[str, object] | None = None,
    minutes: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> QualityReward:
    """Train and write a checkpoint folder; with `minutes` the schedule follows the clock as well."""
    table = dict(scores or paper_scores())
    names = [name for name in paper_levels() if name in table]
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        features = int(levels.tokenizer.mean.numel())
        model = QualityReward(config or QualityConfig(features=features))
    model.set_statistics(levels.tokenizer.statistics)
    optimiser = torch.optim.AdamW(model.parameters(), lr=training.learning_rate, weight_decay=0.01)
    folder.mkdir(parents=True, exist_ok=True)
    began, pool = time.monotonic(), list[tuple[Tensor, Tensor]]()
    with (folder / "metrics.jsonl").open("w") as out:
        for step in range(training.steps):
            share = max(
                step / training.steps, 0 if minutes is None else (time.monotonic() - began) / 60 / minutes
            )
            if share >= 1:
                break
            for group in optimiser.param_groups:
                warm = min(1.0, (step + 1) / 50)
                group["lr"] = training.learning_rate * warm * 0.5 * (1 + math.cos(math.pi * share))
            if step < training.pool:
                random = np.random.default_rng([training.seed, step])
                asked = [names[int(k)] for k in random.integers(len(names), size=training.batch)]
                fresh = levels.mixed(levels.codes(step, training.batch), asked, step)
                pool.append((fresh.half(), torch.tensor([table[name] for name in asked])))
            made, wanted = pool[step % training.pool]
            made = made.float()
            loss = F.smooth_l1_loss(
                model(made), wanted, beta=0.1
            )  # scores lie within 1: quadratic only up close
            optimiser.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimiser.step()
            out.write(json.dumps({"step": step, "loss": round(loss.item(), 6)}) + "\n")
            out.flush()
            if progress is not None:
                progress(step + 1, training.steps)
    told = {"kind": "quality_reward", "training": training.model_dump(), "scores": table}
    model.save(folder, dict(card or {}) | told)
    return model.eval()


@torch.no_grad()
def measure_quality(
    model: QualityReward, levels: Levels, scores: Mapping[str, float], *, windows: int = 32
) -> dict[str, object]:
    """Correlations with the assigned scores on held-out windows, means by level, and rank order on unseen kinds.

    Pearson is over levels (the mean of each level against its score, as the paper's figure) and over single windows.
    `is_ordered` says whether the means fall from rate to rate, by kind.
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
        "is_ordered": {
            kind: bool(
                np.all(np.diff([means[CLEAN], *(means[level_name(kind, rate)] for rate in RATES)]) < 0)
            )
            for kind in get_args(Kind)
        },
        "levels": means,
    }
    unseen, motion = {}, levels.tokenizer.decode(clean)
    for other in get_args(Unseen):
        found = [model(spoiled(motion, other, s, levels.tokenizer.skeleton)).numpy() for s in STRENGTHS]
        severity = np.repeat(STRENGTHS, windows)
        unseen[other] = {
            "spearman": float(spearmanr(severity, np.concatenate(found))[0]),
            "means": [float(one.mean()) for one in found],
        }
    return result | {"unseen": unseen, "windows": windows}


def draw_quality(found: Mapping[str, object], scores: Mapping[str, float], path: Path) -> None:
    """The paper's figure: mean score over severity, made and wanted, for kinds trained on and unseen."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    means, unseen = found["levels"], found["unseen"]
    assert isinstance(means, dict)
    assert isinstance(unseen, dict)
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), sharey=True)
    for axis, kind in zip(axes, get_args(Kind), strict=False):
        names = [CLEAN, *(level_name(kind, rate) for rate in RATES)]
        axis.plot([0, *RATES], [scores[name] for name in names], "--", color="0.5", label="assigned")
        axis.plot([0, *RATES], [means[name] for name in names], "o-", label="reward")
        axis.set_title(f"{kind} (trained on)")
        axis.legend()
    for kind, one in unseen.items():
        axes[2].plot(STRENGTHS, one["means"], "o-", label=kind)
    axes[2].set_title("never trained on")
    axes[2].legend()
    for axis in axes:
        axis.set_xlabel("severity")
    axes[0].set_ylabel("quality reward, held-out")
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)
