"""Trains our FID extractor to reconstruct motion from its latents.

All body parts have equal weight in the loss; otherwise the 30 finger joints would dominate the latents. Windows depend
only on the seed and the step number, so an interrupted run continues exactly.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.training import Loss, TrainingConfig, TrainingTask, adamw, seeded

from .motion_encoder import TRAVEL, MotionEncoder, MotionEncoderConfig

_MEASURED_CLIPS = 64  # clips for measuring the latents' deviation
_NOISE = 30  # multiple of the seed that separates this noise from other draws


class MotionEncoderTraining(TrainingConfig):
    """How the extractor is trained."""

    steps: int = Field(default=1500, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=16, gt=0, description="windows per step")
    frames: int = Field(default=64, gt=0, description="frames of a window, at 30 per second")
    learning_rate: float = Field(default=2e-3, gt=0, description="peak of the schedule")
    warmup: int = Field(default=50, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(default=0.02, ge=0, le=1, description="share of the peak at the end of the cosine")
    weight_decay: float = Field(default=1e-3, ge=0, description="AdamW's decay")
    betas: tuple[float, float] = Field(default=(0.9, 0.999), description="AdamW's averages")
    noise_spread: float = Field(default=0.05, ge=0, description="noise on the input only, in standard deviations")
    speed_weight: float = Field(default=1.0, ge=0, description="weight of the error in frame differences")


class NoisyWindows(NamedTuple):
    """A batch: windows of normalised features, and the noise added to the input."""

    windows: Float[Tensor, "b t c"]
    noise: Float[Tensor, "b t c"]


class MotionEncoderTask(TrainingTask[NoisyWindows]):
    """The training task of the extractor."""

    kind = "fid-encoder"
    config: MotionEncoderTraining

    def __init__(
        self,
        config: MotionEncoderConfig,
        training: MotionEncoderTraining,
        clips: Sequence[Float[Tensor, "_ c"]],
        *,
        card: Mapping[str, object] | None = None,
    ) -> None:
        """Raises MotionError when no clip is as long as a window."""
        self.clips = [clip for clip in clips if len(clip) >= training.frames]
        if not self.clips:
            raise MotionError(f"no clip has {training.frames} frames; give a corpus of longer clips")
        with seeded(training.seed):
            self.model = MotionEncoder(config)
        super().__init__(training, {"model": self.model}, card)
        every = torch.cat([clip[::4] for clip in self.clips])
        self.model.set_feature_statistics(every.mean(0), every.std(0))
        self._weights = part_weights(config.features)

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW."""
        return [adamw([self.model], self.config, decays_vectors=True)]

    def draw(self, step: int) -> NoisyWindows:
        """See `TrainingTask.draw`."""
        random = self.config.noise(step, _NOISE * self.config.seed)
        windows = self.model.normalize(cut_windows(self.clips, self.config.frames, self.config.batch, random))
        return NoisyWindows(windows, torch.randn(windows.shape, generator=random) * self.config.noise_spread)

    def loss(self, batch: NoisyWindows, step: int) -> Loss:
        """Error of features and of their frame differences, in standard deviations, all body parts weighted equally."""
        error = self.model(batch.windows + batch.noise) - batch.windows
        places = F.smooth_l1_loss(error, torch.zeros_like(error), reduction="none")
        steps = error.diff(dim=1).abs()
        of_places, of_steps = ((values * self._weights).sum(-1).mean() for values in (places, steps))
        return Loss(of_places + self.config.speed_weight * of_steps, {})

    def save(self, folder: Path, step: int) -> None:
        """Write the extractor in half precision, its latents rescaled for the present weights."""
        stride = max(1, len(self.clips) // _MEASURED_CLIPS)
        self.model.set_latent_statistics(self.clips[::stride])
        super().save(folder, step)


def cut_windows(
    clips: Sequence[Float[Tensor, "_ c"]], frames: int, count: int, random: torch.Generator
) -> Float[Tensor, "b t c"]:
    """`count` windows of `frames` frames, uniform over all positions in the clips."""
    starts = torch.tensor([len(clip) - frames + 1 for clip in clips]).double()
    chosen = torch.multinomial(starts, count, replacement=True, generator=random)
    at = (torch.rand(count, generator=random) * starts[chosen]).long()
    return torch.stack([clips[clip][first : first + frames] for clip, first in zip(chosen, at, strict=True)])


def part_weights(features: int) -> Float[Tensor, " c"]:
    """Weights with sum 1 that are equal for each body part and for travel; uniform for another number of features."""
    weights = torch.full((features,), 1.0 / features)
    if features == 6 * HUMANOID.joints + TRAVEL:
        parts = list(HUMANOID.config.parts.values())
        share = 1 / (len(parts) + 1)
        for joints in parts:
            columns = [6 * joint + k for joint in joints for k in range(6)]
            weights[columns] = share / len(columns)
        weights[-TRAVEL:] = share / TRAVEL
    return weights


@torch.no_grad()
def explained_variance(model: MotionEncoder, clips: Sequence[Float[Tensor, "_ c"]]) -> float:
    """Share of the features' variance that the latents preserve, all body parts weighted equally; 1 is everything."""
    weights, error, total = part_weights(model.config.features), 0.0, 0.0
    for clip in clips:
        whole = len(clip) - len(clip) % model.frames_per_latent
        if whole:
            seen = model.normalize(clip[None, :whole])
            error += float(((model(seen) - seen) ** 2 * weights).sum())
            total += float((seen**2 * weights).sum())
    return 1 - error / max(total, 1e-12)
