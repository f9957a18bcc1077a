"""Training of the finger model on motion with good fingers.

The paper (Motion Refinement) trains on ZeroEGGS, whose licence does not allow sharing the weights. The shipped model is
trained on synthetic and recorded clips in a fixed ratio. All randomness of a step follows from seed and step number.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.models.fingers.clips import FingerClip, fit_basis, mirror_body
from echoavatar.models.fingers.model import FingerConfig, FingerModel
from echoavatar_lab.training import Loss, Progress, TrainingTask, train

from .recipe import FingerTraining
from .windows import FingerBatch, FingerNoise, FingerSampler, count_learned_hands, denoising_loss, draw_noise

_NOISE = 30  # factor of the seed, so that noise and windows of a step differ


class NoisyFingerBatch(NamedTuple):
    """A batch: windows and all random numbers of their loss."""

    windows: FingerBatch
    noise: FingerNoise


class FingerTask(TrainingTask[NoisyFingerBatch]):
    """A finger model and the clips with moving fingers that it is trained on."""

    config: FingerTraining

    def __init__(
        self,
        config: FingerConfig,
        training: FingerTraining,
        clips: Sequence[FingerClip],
        recorded: Sequence[FingerClip] = (),
        *,
        card: Mapping[str, object] | None = None,
    ) -> None:
        """Raises MotionError if no clip has moving fingers."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.model = FingerModel(config)
        super().__init__(training, {"model": self.model})
        groups = [[clip for clip in group if clip.is_moving.any()] for group in (clips, recorded)]
        shares = [1 - training.recorded if groups[1] else 1.0, training.recorded]
        pairs = [(group, share) for group, share in zip(groups, shares, strict=True) if group]
        if not pairs:
            raise MotionError("no clip has fingers that move; give clips with good fingers")
        groups, shares = [group for group, _ in pairs], [share for _, share in pairs]
        _measure(self.model, groups)
        self.sampler = FingerSampler(self.model, groups, shares, seed=training.seed)
        self._card = dict(card or {})

    def identity(self) -> dict[str, FingerConfig | FingerTraining]:
        """Sizes and schedule."""
        return {"fingers": self.model.config, "training": self.config}

    def draw(self, step: int) -> NoisyFingerBatch:
        """See `TrainingTask.draw`; windows are normalised by the model's fixed statistics."""
        windows = self.sampler.batch(step, self.config.batch)
        return NoisyFingerBatch(windows, draw_noise(windows, self.config.noise(step, _NOISE * self.config.seed)))

    def weight(self, batch: NoisyFingerBatch) -> float:
        """Number of hands in the loss."""
        return count_learned_hands(batch.windows, self.config, batch.noise)

    def loss(self, batch: NoisyFingerBatch, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        return Loss(denoising_loss(self.model, batch.windows, self.config, batch.noise), {})

    def save(self, folder: Path, step: int) -> None:
        """The finger model, in half precision."""
        about = {"kind": "fingers", "step": step, "training": self.config.model_dump()}
        self.model.save(folder, self._card | about)


def train_fingers(
    config: FingerConfig,
    training: FingerTraining,
    clips: Sequence[FingerClip],
    folder: Path,
    *,
    recorded: Sequence[FingerClip] = (),
    minutes: float | None = None,
    card: Mapping[str, object] | None = None,
    trackers: Sequence[str] = (),
    progress: Progress | None = None,
) -> FingerModel:
    """Train with checkpoints in `folder`, or continue from the checkpoint there.

    Stops after the schedule's steps, or after `minutes` of this call.
    """
    stage = FingerTask(config, training, clips, recorded, card=card)
    train(stage, folder, minutes=minutes, trackers=trackers, progress=progress)
    return FingerModel.load(folder)


def _measure(model: FingerModel, groups: Sequence[Sequence[FingerClip]]) -> None:
    """Set the model's statistics; every group counts equally, whatever its length."""
    moving = [torch.cat([clip.hands[:, clip.is_moving].flatten(0, 1) for clip in group]) for group in groups]
    bodies = [torch.cat([clip.body for clip in group]) for group in groups]
    hands, body = torch.cat(_equal_length(moving)), torch.cat(_equal_length(bodies))
    body = torch.cat([body, mirror_body(body)])
    model.set_statistics(fit_basis(hands, model.config.poses), body.mean(0), body.std(0))


def _equal_length(groups: Sequence[Tensor]) -> list[Tensor]:
    """Resample all groups to the same number of rows: that of the longest, at most 20,000."""
    count = min(20_000, max(len(rows) for rows in groups))
    return [rows[torch.linspace(0, len(rows) - 1, count).long()] for rows in groups]
