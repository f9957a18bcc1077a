"""Training of the face model: flow matching with audio dropout.

Paper, Face Animation Generator: MSE flow matching, 10 % audio dropout, AdamW 2e-4, batch 128, windows of 64 frames,
300 000 iterations. Everything random in a step follows from the seed and the step's number. Departs from the paper: the
history that the model sees is corrupted, so that the model uses the sound instead of copying the last frame. The
encoder, which is not pretrained as HuBERT is, may train alone at first.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from echoavatar import checkpoint
from echoavatar.models.face.config import FaceConfig
from echoavatar.models.face.encoder import HubertEncoder
from echoavatar.models.face.model import FaceModel
from echoavatar_lab.training import Loss, Progress, TrainingTask, has_state, train

from .clip import FaceClip
from .losses import FaceReader, FlowNoise, draw_noise, flow_loss
from .recipe import FaceTraining
from .tempo import SPEEDS
from .windows import FaceBatch, FaceSampler, levelled


class FaceLesson(NamedTuple):
    """A batch: windows and all noise of the loss."""

    windows: FaceBatch
    noise: FlowNoise


class FaceTask(TrainingTask[FaceLesson]):
    """A face model and the clips of split "train"."""

    config: FaceTraining

    def __init__(
        self,
        config: FaceConfig,
        training: FaceTraining,
        clips: Sequence[FaceClip],
        *,
        card: Mapping[str, object] | None = None,
    ) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.model = FaceModel(config)
            self.reader = FaceReader(config.encoder.outputs, config.channels)
        super().__init__(training, {"model": self.model, "reader": self.reader})
        self.has_idle = training.listen > 0
        chosen = [levelled(clip) for clip in clips if clip.split == "train"]
        self.sampler = FaceSampler(
            chosen,
            frames=training.frames,
            seed=training.seed,
            gain_db=training.gain_db,
            speeds=SPEEDS if training.tempo else (1.0,),
            late=config.late,
        )
        self.model.measure(torch.from_numpy(np.concatenate([clip.curves for clip in chosen])))
        self._card = dict(card or {})

    def identity(self) -> dict[str, FaceConfig | FaceTraining]:
        """Sizes and schedule."""
        return {"face": self.model.config, "training": self.config}

    def rate(self, step: int, done: float) -> float:
        """Warm-up and decay; the steps in which the encoder trains alone have a schedule of their own."""
        training, listen = self.config, self.config.listen
        if step < listen:
            peak, at, steps = training.listening_rate, step, listen
        else:
            peak, at, steps = training.learning_rate, step - listen, training.steps - listen
        warm = min(1.0, (at + 1) / max(1, training.warmup))
        return peak * warm * training.decayed(min(1.0, at / max(1, steps)))

    def draw(self, step: int) -> FaceLesson:
        """See `TrainingTask.draw`."""
        windows = self.sampler.batch(step, self.config.batch)
        return FaceLesson(windows, draw_noise(windows.curves, self.config, self.config.noise(step)))

    def loss(self, batch: FaceLesson, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        training, windows = self.config, batch.windows
        features = self.model.encoder(windows.audio)
        read = self.reader.loss(self.model, features, windows.curves)
        if step < training.listen:
            return Loss(read, {"read": read})
        flow = flow_loss(self.model, windows, training, batch.noise, features=features)
        return Loss(flow + training.readout * read, {"read": read})

    def save(self, folder: Path, step: int) -> None:
        """The face model."""
        about = {"kind": "face", "step": step, "training": self.config.model_dump()}
        self.model.save(folder, self._card | about)


def train_face(
    config: FaceConfig,
    training: FaceTraining,
    clips: Sequence[FaceClip],
    folder: Path,
    *,
    minutes: float | None = None,
    device: str = "cpu",
    start: FaceModel | None = None,
    encoder: HubertEncoder | None = None,
    card: Mapping[str, object] | None = None,
    trackers: Sequence[str] = (),
    progress: Progress | None = None,
) -> FaceModel:
    """Train on the clips of split "train", checkpointing into `folder` with `card`; continues what is there.

    A new run begins with the weights of `start`, where given, under a schedule of its own. A pretrained `encoder`, of
    the config's sizes, is kept as it is; the rest learns.
    Stops after the schedule's steps, or after `minutes` of this call.
    """
    stage = FaceTask(config, training, clips, card=card)
    if encoder is not None:
        checkpoint.load_into(stage.model.encoder, encoder.state_dict(), origin="the pretrained encoder")
        stage.model.encoder.freeze()  # type: ignore[operator]
    if start is not None and not has_state(folder):
        checkpoint.load_into(stage.model, start.state_dict(), origin="the face model to start from")
    train(stage, folder, minutes=minutes, device=device, trackers=trackers, progress=progress)
    return stage.model.eval()
