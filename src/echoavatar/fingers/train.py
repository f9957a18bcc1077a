"""Training of the finger model on motion with good fingers.

Paper, Motion Refinement: trained on the fingers of ZeroEGGS, which may not train weights that are passed on; ours
learns from clips of two kinds, many made by rule and few recorded, in a fixed share. Everything random in a step
follows from the seed and the step's number.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from ..errors import MotionError
from ..training import Loss, Progress, Stage, train
from .body_features import mirror_body
from .clips import FingerClip
from .config import FingerConfig
from .hand_poses import fit_basis
from .model import FingerModel
from .recipe import FingerTraining
from .windows import FingerBatch, FingerNoise, FingerSampler, count_learned_hands, denoising_loss, draw_noise

_NOISE = 30  # times the seed: noise and windows of a step follow from different numbers


class NoisyFingerBatch(NamedTuple):
    """A batch: windows, and all noise on them."""

    windows: FingerBatch
    noise: FingerNoise


class FingerTask(Stage[NoisyFingerBatch]):
    """A finger model and the clips with moving fingers that it learns."""

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
        """Raises MotionError when no clip has moving fingers."""
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
        """See `Stage.draw`; normalised by the model's statistics, which stay."""
        windows = self.sampler.batch(step, self.config.batch)
        return NoisyFingerBatch(
            windows, draw_noise(windows, self.config.noise(step, _NOISE * self.config.seed))
        )

    def weight(self, batch: NoisyFingerBatch) -> float:
        """Hands that carry loss."""
        return count_learned_hands(batch.windows, self.config, batch.noise)

    def loss(self, batch: NoisyFingerBatch, step: int) -> Loss:
        """See `Stage.loss`."""
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
    """Train, checkpointing into `folder` with `card`; continues what is there.

    Stops after the schedule's steps, or after `minutes` of this call.
    """
    stage = FingerTask(config, training, clips, recorded, card=card)
    train(stage, folder, minutes=minutes, trackers=trackers, progress=progress)
    return FingerModel.load(folder)


def _measure(model: FingerModel, groups: Sequence[Sequence[FingerClip]]) -> None:
    """Statistics in which every group has the same say, however long its clips."""
    alive = [torch.cat([clip.hands[:, clip.is_moving].flatten(0, 1) for clip in group]) for group in groups]
    bodies = [torch.cat([clip.body for clip in group]) for group in groups]
    hands, body = torch.cat(_equal_length(alive)), torch.cat(_equal_length(bodies))
    body = torch.cat([body, mirror_body(body)])
    model.measure(fit_basis(hands, model.config.poses), body.mean(0), body.std(0))


def _equal_length(groups: Sequence[Tensor]) -> list[Tensor]:
    """As many rows of each, evenly spaced: those of the longest, 20,000 at most."""
    count = min(20_000, max(len(rows) for rows in groups))
    return [rows[torch.linspace(0, len(rows) - 1, count).long()] for rows in groups]
