"""Training of the face model: flow matching with audio dropout, resumable to the same curve.

Paper, Face Animation Generator: MSE flow matching, 10 % audio dropout, AdamW 2e-4, batch 128, windows of 64 frames,
300 000 iterations. Everything random in a step follows from the seed and the step's number. Departs from the paper: the
history that the model is shown is corrupted, so that it listens instead of copying the last frame.
"""

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from .. import checkpoint
from ..audio import LevelControl
from ..config import Config
from ..errors import CheckpointError, MotionError
from ..timing import CHUNK_FRAMES, SAMPLES_PER_FRAME
from .arkit import index_of
from .clip import FaceClip
from .config import FaceConfig
from .flow import FULL_NOISE, add_noise
from .model import FaceModel
from .tempo import SPEEDS, at_speed

RESUME = "resume.safetensors"
TOUCHING = 0.05  # of a jaw's way: lips that touch


class FaceTraining(Config):
    """How a face model is trained. The defaults suit a small model on a CPU; the paper's numbers are in the text."""

    steps: int = Field(
        default=8000, gt=0, description="optimiser steps of the whole schedule (paper: 300,000)"
    )
    batch: int = Field(default=32, gt=0, description="windows per step (paper: 128)")
    frames: int = Field(
        default=64, gt=0, multiple_of=CHUNK_FRAMES, description="frames per window (paper: 64)"
    )
    learning_rate: float = Field(
        default=1e-3, gt=0, description="peak of the schedule (paper: 2e-4, constant)"
    )
    warmup: int = Field(default=100, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(
        default=0.05, ge=0, le=1, description="share of the peak at the end of the cosine"
    )
    weight_decay: float = Field(default=0.01, ge=0, description="AdamW decay of matrices")
    clip: float = Field(default=1.0, gt=0, description="largest norm of the gradient")
    audio_dropout: float = Field(
        default=0.1, ge=0, le=1, description="share of windows without sound (paper: 0.1)"
    )
    history_noise: float = Field(
        default=1.5,
        ge=0,
        description="largest deviation of the noise on a window's history; 0 as in the paper",
    )
    history_dropout: float = Field(
        default=0.3,
        ge=0,
        le=1,
        description="share of windows whose history is the mean face; 0 as in the paper",
    )
    gain_db: float = Field(default=6.0, ge=0, description="windows are made louder or softer by up to this")
    high_noise: float = Field(
        default=2.0,
        ge=1,
        description="noise levels are u^(1 / this), u uniform: high noise makes sound tell; 1 is uniform",
    )
    lips: float = Field(
        default=0.3,
        ge=0,
        description="weight of the error of the lips' opening, four times where they touch; 0 as in the paper",
    )
    draws: int = Field(default=2, gt=0, description="noise levels per frame and step")
    seed: int = Field(default=0, description="of weights, windows, noise")
    save_every: int = Field(default=200, gt=0, description="steps between checkpoints")


class FaceBatch(NamedTuple):
    """Windows: sound, curves, and the frame before each window."""

    audio: Float[Tensor, "b s"]
    curves: Float[Tensor, "b t c"]
    before: Float[Tensor, "b c"]


class FaceSampler:
    """Windows of clips at three speeds, from any frame on; the same for the same seed and step."""

    def __init__(self, clips: Sequence[FaceClip], *, frames: int, seed: int, gain_db: float = 0.0) -> None:
        long_enough = [clip for clip in clips if round(len(clip.curves) / max(SPEEDS)) > frames]
        if not long_enough:
            raise MotionError(
                f"no face clip of split train is longer than {frames} frames; record longer takes"
            )
        self._versions = [[at_speed(clip, speed) for speed in SPEEDS] for clip in long_enough]
        lengths = np.array([len(clip.curves) for clip in long_enough], float)
        self._share, self._frames, self._seed, self._gain_db = lengths / lengths.sum(), frames, seed, gain_db

    def batch(self, step: int, rows: int) -> FaceBatch:
        """The windows of one step."""
        rng = np.random.default_rng([self._seed, step])
        audio, curves, before = [], [], []
        for which in rng.choice(len(self._versions), rows, p=self._share):
            clip = self._versions[which][rng.integers(len(SPEEDS))]
            first = int(rng.integers(len(clip.curves) - self._frames + 1))
            last = first + self._frames
            gain = 10 ** (rng.uniform(-self._gain_db, self._gain_db) / 20)
            audio.append(gain * clip.audio[first * SAMPLES_PER_FRAME : last * SAMPLES_PER_FRAME])
            curves.append(clip.curves[first:last])
            before.append(clip.curves[max(first - 1, 0)])
        return FaceBatch(
            *(torch.from_numpy(np.stack(part).astype(np.float32)) for part in (audio, curves, before))
        )


def flow_loss(
    model: FaceModel, batch: FaceBatch, training: FaceTraining, random: torch.Generator
) -> Float[Tensor, ""]:
    """Squared error of the clean face seen behind noise (normalised), over the channels that move, and of the lips."""
    clean = model.normalize(batch.curves)
    history = torch.cat([model.normalize(batch.before)[:, None], clean[:, :-1]], 1)
    rows, frames, channels = clean.shape

    def chance(share: float) -> Tensor:
        return (torch.rand(rows, 1, 1, generator=random) >= share).float()

    strength = training.history_noise * torch.rand(rows, 1, 1, generator=random)
    noisy = history + strength * torch.randn(rows, frames, channels, generator=random)
    history = noisy * chance(training.history_dropout) * model.moving()
    sound = model.gpt.sound_proj(model.encoder(batch.audio)) * chance(training.audio_dropout)
    condition = model.gpt(history, sound)
    shape = (training.draws, rows, frames)
    level = torch.rand(shape, generator=random) ** (1 / training.high_noise)
    times = (level * FULL_NOISE).ceil().long().clamp(1, FULL_NOISE)
    noise = torch.randn(*shape, channels, generator=random)
    seen = model.head(add_noise(clean.expand(*shape, -1), noise, times), times, condition.expand(*shape, -1))
    error = (seen - clean).square() * model.moving()
    loss: Tensor = error.sum() / (math.prod(shape) * model.moving().sum().clamp_min(1))
    return loss + training.lips * _lip_error(model.denormalize(seen), batch.curves) if training.lips else loss


def _lip_error(seen: Float[Tensor, "n b t c"], curves: Float[Tensor, "b t c"]) -> Float[Tensor, ""]:
    """Squared error of how far the lips are apart (jaw less closure) in tenths of a jaw's way; touching counts most."""
    jaw, close = index_of("jawOpen"), index_of("mouthClose")
    apart, wanted = seen[..., jaw] - seen[..., close], curves[..., jaw] - curves[..., close]
    weight = torch.where(wanted <= TOUCHING, 4.0, 1.0)
    return (weight * (apart - wanted).square()).mean() * 100


def levelled(clip: FaceClip) -> FaceClip:
    """The clip as the live model hears it, behind the level control."""
    audio = LevelControl()(torch.from_numpy(clip.audio)[None])[0].numpy()
    return replace(clip, audio=audio)


class FaceTrainer:
    """A model, its optimiser and the number of the next step."""

    def __init__(self, config: FaceConfig, training: FaceTraining, clips: Sequence[FaceClip]) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.model = FaceModel(config)
        chosen = [levelled(clip) for clip in clips if clip.split == "train"]
        self.sampler = FaceSampler(
            chosen, frames=training.frames, seed=training.seed, gain_db=training.gain_db
        )
        self.model.measure(torch.from_numpy(np.concatenate([clip.curves for clip in chosen])))
        self.training, self.next_step = training, 0
        groups = [
            {
                "params": [p for p in self.model.parameters() if p.dim() > 1],
                "weight_decay": training.weight_decay,
            },
            {"params": [p for p in self.model.parameters() if p.dim() <= 1], "weight_decay": 0.0},
        ]
        self._optimiser = torch.optim.AdamW(groups, lr=training.learning_rate, betas=(0.9, 0.98))

    def step(self) -> dict[str, float]:
        """One optimiser step; returns its metrics."""
        training, number = self.training, self.next_step
        random = torch.Generator().manual_seed(training.seed * 1_000_003 + number)
        for group in self._optimiser.param_groups:
            group["lr"] = training.learning_rate * self._schedule(number)
        loss = flow_loss(self.model, self.sampler.batch(number, training.batch), training, random)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        norm = nn.utils.clip_grad_norm_(self.model.parameters(), training.clip)
        self._optimiser.step()
        self.next_step += 1
        return {"step": number, "loss": loss.item(), "gradient": norm.item()}

    def _schedule(self, number: int) -> float:
        training = self.training
        warm = min(1.0, (number + 1) / max(1, training.warmup))
        done = min(1.0, number / training.steps)
        return warm * (training.final_rate + (1 - training.final_rate) * 0.5 * (1 + math.cos(math.pi * done)))

    def save(self, folder: Path, card: Mapping[str, object] | None = None) -> None:
        """Write everything a resumed run needs as one file, at once or not at all; then the model as a checkpoint."""
        state = {
            f"model.{key}": value.detach().contiguous() for key, value in self.model.state_dict().items()
        }
        for index, values in self._optimiser.state_dict()["state"].items():
            state |= {f"optimiser.{index}.{name}": value.contiguous() for name, value in values.items()}
        facts = {"step": str(self.next_step), "training": self.training.model_dump_json()}
        folder.mkdir(parents=True, exist_ok=True)
        partial = folder / f"{RESUME}.partial"
        save_file(state, partial, metadata=facts | {"config": self.model.config.model_dump_json()})
        partial.replace(folder / RESUME)
        facts_for_card = {"kind": "face", "step": self.next_step, "training": self.training.model_dump()}
        self.model.save(folder, {**(card or {}), **facts_for_card})

    def resume(self, folder: Path) -> bool:
        """Continue from a folder written by `save`; False where there is none.

        Raises:
            CheckpointError: the folder holds another model, or another schedule, or is damaged.
        """
        path = folder / RESUME
        if not path.exists():
            return False
        try:
            with safe_open(path, "pt") as file:
                facts = file.metadata()
            tensors = load_file(path)
        except SafetensorError as error:
            raise CheckpointError(f"{path} is damaged ({error}); delete it to begin again") from error
        if FaceConfig.model_validate_json(facts["config"]) != self.model.config:
            raise CheckpointError(f"{folder} holds a face model of another config; train into another folder")
        if FaceTraining.model_validate_json(facts["training"]) != self.training:
            raise CheckpointError(f"{folder} was trained with other settings; train into another folder")
        weights = {key[len("model.") :]: value for key, value in tensors.items() if key.startswith("model.")}
        checkpoint.load_into(self.model, weights, origin=str(path))
        stored = defaultdict[int, dict[str, Tensor]](dict)
        for key in (key for key in tensors if key.startswith("optimiser.")):
            _, index, name = key.split(".", 2)
            stored[int(index)][name] = tensors[key]
        groups = self._optimiser.state_dict()["param_groups"]
        self._optimiser.load_state_dict({"state": dict(stored), "param_groups": groups})
        self.next_step = int(facts["step"])
        return True


def train_face(
    config: FaceConfig,
    training: FaceTraining,
    clips: Sequence[FaceClip],
    folder: Path,
    *,
    minutes: float | None = None,
    start: FaceModel | None = None,
    card: Mapping[str, object] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FaceModel:
    """Train on the clips of split "train", checkpointing into `folder` with `card`; continues what is there.

    A new run begins with the weights of `start`, where given, under a schedule of its own.
    Stops after the schedule's steps, or after `minutes` of this call; metrics go to `folder`/metrics.jsonl.
    """
    trainer = FaceTrainer(config, training, clips)
    if not trainer.resume(folder) and start is not None:
        checkpoint.load_into(trainer.model, start.state_dict(), origin="the face model to start from")
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "metrics.jsonl"
    if log.exists():  # drop the lines of steps that this run repeats
        lines = [line for line in log.read_text().splitlines() if line]
        kept = [line for line in lines if json.loads(line)["step"] < trainer.next_step]
        log.write_text("".join(line + "\n" for line in kept))
    deadline = math.inf if minutes is None else time.monotonic() + 60 * minutes
    trainer.model.train()
    with log.open("a") as out:
        while trainer.next_step < training.steps and time.monotonic() < deadline:
            began = time.monotonic()
            metrics = trainer.step()
            out.write(json.dumps(metrics | {"seconds": round(time.monotonic() - began, 3)}) + "\n")
            out.flush()
            if trainer.next_step % training.save_every == 0:
                trainer.save(folder, card)
            if progress is not None:
                progress(trainer.next_step, training.steps)
    trainer.save(folder, card)
    return trainer.model.eval()
