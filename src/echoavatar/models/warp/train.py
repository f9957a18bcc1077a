"""Train the warp model on clips whose stresses and beats are known, such as the rehearsal corpus."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F

from echoavatar.data import Clip
from echoavatar.training import Loss, Progress, TrainingTask, train

from .config import WarpConfig
from .model import WarpModel
from .recipe import WarpTraining
from .targets import WarpBatch, WarpSampler


class WarpTask(TrainingTask[WarpBatch]):
    """A warp model and its clips."""

    config: WarpTraining

    def __init__(
        self,
        config: WarpConfig,
        training: WarpTraining,
        clips: Sequence[Clip],
        *,
        card: Mapping[str, object] | None = None,
    ) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.model = WarpModel(config)
        super().__init__(training, {"model": self.model})
        self.sampler = WarpSampler(clips, frames=training.frames, seed=training.seed, gain_db=training.gain_db)
        self._card = dict(card or {})

    def identity(self) -> dict[str, WarpConfig | WarpTraining]:
        """Sizes and schedule."""
        return {"warp": self.model.config, "training": self.config}

    def draw(self, step: int) -> WarpBatch:
        """See `TrainingTask.draw`."""
        return self.sampler.batch(step, self.config.batch)

    def loss(self, batch: WarpBatch, step: int) -> Loss:
        """Cross-entropy with the target curve; `blind` is that of a model which always gives the batch's mean."""
        logits = self.model.logits(self.model.encoder(batch.audio))
        error = F.binary_cross_entropy_with_logits(logits, batch.brake)
        blind = F.binary_cross_entropy(batch.brake.mean().expand_as(batch.brake), batch.brake)
        return Loss(error, {"blind": blind})

    def save(self, folder: Path, step: int) -> None:
        """The warp model."""
        about = {"kind": "warp", "step": step, "training": self.config.model_dump()}
        self.model.save(folder, self._card | about)


def train_warp(
    config: WarpConfig,
    training: WarpTraining,
    clips: Sequence[Clip],
    folder: Path,
    *,
    minutes: float | None = None,
    device: str = "cpu",
    card: Mapping[str, object] | None = None,
    trackers: Sequence[str] = (),
    progress: Progress | None = None,
) -> WarpModel:
    """Train on the clips, with checkpoints and `card` in `folder`; resumes an interrupted run."""
    task = WarpTask(config, training, clips, card=card)
    train(task, folder, minutes=minutes, device=device, trackers=trackers, progress=progress)
    return task.model.eval()
