"""Trains an extractor of our own for BEAT2, for users without a copy of EMAGE's weights.

Same network and input as EMAGE's, trained to reconstruct motion from the encoder's output, which FID uses. EMAGE's is
variational and saw more data, so FID values of the two cannot be compared.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar_lab.training import Loss, Progress, TrainingConfig, TrainingTask, train

from .skeleton_convolution import CLIP_MULTIPLE, SkeletonConvolution, SkeletonConvolutionConfig


class SkeletonConvolutionTraining(TrainingConfig):
    """How the extractor is trained."""

    steps: int = Field(default=2000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=16, gt=0, description="windows per step")
    frames: int = Field(default=64, gt=0, multiple_of=CLIP_MULTIPLE, description="frames of a window, at 30 per second")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule")
    warmup: int = Field(default=50, ge=0, description="steps of linear warm-up")
    speed_weight: float = Field(default=1.0, ge=0, description="weight of the error in frame differences")


class SkeletonConvolutionTask(TrainingTask[Tensor]):
    """The training task of the extractor."""

    config: SkeletonConvolutionTraining

    def __init__(
        self,
        config: SkeletonConvolutionConfig,
        training: SkeletonConvolutionTraining,
        clips: Sequence[Float[Tensor, "_ c"]],
        *,
        card: Mapping[str, object] | None = None,
    ) -> None:
        """Raises MotionError when no clip is as long as a window."""
        self.clips = [clip for clip in clips if len(clip) >= training.frames]
        if not self.clips:
            raise MotionError(f"no clip has {training.frames} frames; give a set of longer clips")
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.model = SkeletonConvolution(config)
        for head in (self.model.fc_mu, self.model.fc_logvar):
            head.requires_grad_(False)  # FID does not use them
        super().__init__(training, {"model": self.model})
        self._card = dict(card or {})

    def identity(self) -> dict[str, SkeletonConvolutionConfig | SkeletonConvolutionTraining]:
        """Sizes and schedule."""
        return {"extractor": self.model.config, "training": self.config}

    def draw(self, step: int) -> Float[Tensor, "b t c"]:
        """See `TrainingTask.draw`: windows, uniform over all positions in the data."""
        random, frames = self.config.noise(step), self.config.frames
        starts = torch.tensor([len(clip) - frames + 1 for clip in self.clips]).double()
        chosen = torch.multinomial(starts, self.config.batch, replacement=True, generator=random)
        at = (torch.rand(self.config.batch, generator=random) * starts[chosen]).long()
        pairs = zip(chosen.tolist(), at.tolist(), strict=True)
        return torch.stack([self.clips[clip][start : start + frames] for clip, start in pairs])

    def loss(self, batch: Float[Tensor, "b t c"], step: int) -> Loss:
        """Error of rotations and of their frame differences."""
        error = self.model.decode(self.model.encode(batch)) - batch
        places = F.smooth_l1_loss(error, torch.zeros_like(error))
        return Loss(places + self.config.speed_weight * error.diff(dim=1).abs().mean(), {"places": places})

    def save(self, folder: Path, step: int) -> None:
        """Write the extractor."""
        about = {"kind": "beat2-extractor", "step": step, "training": self.config.model_dump()}
        self.model.save(folder, self._card | about)


def train_skeleton_convolution(
    config: SkeletonConvolutionConfig,
    training: SkeletonConvolutionTraining,
    clips: Sequence[Float[Tensor, "_ c"]],
    folder: Path,
    *,
    device: str = "cpu",
    card: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> SkeletonConvolution:
    """Train on clips of `extractor_input`, with checkpoints in `folder`; resumes the run in it."""
    stage = SkeletonConvolutionTask(config, training, clips, card=card)
    train(stage, folder, device=device, progress=progress)
    return SkeletonConvolution.load(folder)
