"""Trains our extractor to give motion back from its latents: a minute or two on a CPU.

Every part of the body has the same say in the loss, else 30 finger joints would decide what a latent is about.
Windows follow from the seed and the step's number, so a run that was stopped goes on as if it had not been.
"""

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from .. import checkpoint
from ..config import Config
from ..errors import CheckpointError, MotionError
from ..kinematics import HUMANOID
from .motion_encoder import MotionEncoder, MotionEncoderConfig
from .motion_features import TRAVEL

RESUME = "resume.safetensors"
_MEASURED_CLIPS = 64  # clips that the latents' spread is measured on


class MotionEncoderTraining(Config):
    """How the extractor is trained."""

    steps: int = Field(default=1500, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=16, gt=0, description="windows per step")
    frames: int = Field(default=64, gt=0, description="frames of a window, at 30 per second")
    learning_rate: float = Field(default=2e-3, gt=0, description="peak of the schedule")
    warmup: int = Field(default=50, ge=0, description="steps of linear warm-up")
    noise: float = Field(default=0.05, ge=0, description="on the input, in its spreads; the target has none")
    speed_weight: float = Field(default=1.0, ge=0, description="weight of the error from frame to frame")
    seed: int = Field(default=0, description="of weights, windows, noise")
    save_every: int = Field(default=200, gt=0, description="steps between checkpoints")


class MotionEncoderTrainer:
    """A model, its optimiser and the number of the next step."""

    def __init__(
        self,
        config: MotionEncoderConfig,
        training: MotionEncoderTraining,
        clips: Sequence[Float[Tensor, "t c"]],
    ) -> None:
        """Raises MotionError when no clip is as long as a window."""
        self.clips = [clip for clip in clips if len(clip) >= training.frames]
        if not self.clips:
            raise MotionError(f"no clip has {training.frames} frames; give a corpus of longer clips")
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.model = MotionEncoder(config)
        every = torch.cat([clip[::4] for clip in self.clips])
        self.model.measure(every.mean(0), every.std(0))
        self.training, self.next_step = training, 0
        self._weights = part_weights(config.features)
        self._optimiser = torch.optim.AdamW(
            self.model.parameters(), lr=training.learning_rate, weight_decay=1e-3
        )

    def step(self) -> dict[str, float]:
        """One optimiser step; returns its metrics."""
        training, number = self.training, self.next_step
        random = torch.Generator().manual_seed(training.seed * 1_000_033 + number)
        done = number / training.steps
        rate = min(1.0, (number + 1) / max(1, training.warmup)) * (
            0.02 + 0.49 * (1 + math.cos(math.pi * done))
        )
        for group in self._optimiser.param_groups:
            group["lr"] = training.learning_rate * rate
        windows = self._windows(random)
        noise = torch.randn(windows.shape, generator=random) * training.noise
        loss = self.loss(windows, windows + noise)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        self._optimiser.step()
        self.next_step += 1
        return {"step": number, "loss": loss.item()}

    def loss(self, target: Float[Tensor, "b t c"], seen: Float[Tensor, "b t c"]) -> Tensor:
        """Error of places and of steps from frame to frame, in spreads, every part of the body alike."""
        error = self.model(seen) - target
        places = F.smooth_l1_loss(error, torch.zeros_like(error), reduction="none")
        steps = error.diff(dim=1).abs()
        of_places, of_steps = ((values * self._weights).sum(-1).mean() for values in (places, steps))
        total: Tensor = of_places + self.training.speed_weight * of_steps
        return total

    def _windows(self, random: torch.Generator) -> Float[Tensor, "b t c"]:
        lengths = torch.tensor([len(clip) - self.training.frames + 1 for clip in self.clips]).double()
        chosen = torch.multinomial(lengths, self.training.batch, replacement=True, generator=random)
        shares = torch.rand(self.training.batch, generator=random)
        cut = []
        for clip, share in zip(chosen.tolist(), shares.tolist(), strict=True):
            start = int(share * int(lengths[clip]))
            cut.append(self.clips[clip][start : start + self.training.frames])
        return self.model.normalize(torch.stack(cut))

    def save(self, folder: Path, card: Mapping[str, object] | None = None) -> None:
        """Write what a resumed run needs as one file, at once or not at all; then the model, in half precision."""
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
        stride = max(1, len(self.clips) // _MEASURED_CLIPS)
        self.model.measure_latents(self.clips[::stride])
        about = {"kind": "fid-encoder", "step": self.next_step, "training": self.training.model_dump()}
        self.model.save(folder, {**(card or {}), **about})

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
        same = MotionEncoderConfig.model_validate_json(facts["config"]) == self.model.config
        if not same or MotionEncoderTraining.model_validate_json(facts["training"]) != self.training:
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


def part_weights(features: int) -> Float[Tensor, " c"]:
    """Weights of sum 1 that give each part of our rig, and travel, the same say; all alike for another size."""
    weights = torch.full((features,), 1.0 / features)
    if features == 6 * HUMANOID.joints + TRAVEL:
        parts = list(HUMANOID.config.parts.values())
        share = 1 / (len(parts) + 1)
        for joints in parts:
            columns = [6 * joint + k for joint in joints for k in range(6)]
            weights[columns] = share / len(columns)
        weights[-TRAVEL:] = share / TRAVEL
    return weights


def train_motion_encoder(
    config: MotionEncoderConfig,
    training: MotionEncoderTraining,
    clips: Sequence[Float[Tensor, "t c"]],
    folder: Path,
    *,
    minutes: float | None = None,
    card: Mapping[str, object] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> MotionEncoder:
    """Train on clips of `motion_features`, checkpointing into `folder`; continues what is there.

    Stops after the schedule's steps, or after `minutes` of this call; metrics go to `folder`/metrics.jsonl.
    """
    trainer = MotionEncoderTrainer(config, training, clips)
    trainer.resume(folder)
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "metrics.jsonl"
    if log.exists():  # drop the lines of steps that this run repeats
        lines = [line for line in log.read_text().splitlines() if line]
        kept = [line for line in lines if json.loads(line)["step"] < trainer.next_step]
        log.write_text("".join(line + "\n" for line in kept))
    deadline = math.inf if minutes is None else time.monotonic() + 60 * minutes
    with log.open("a") as out:
        while trainer.next_step < training.steps and time.monotonic() < deadline:
            out.write(json.dumps(trainer.step()) + "\n")
            out.flush()
            if trainer.next_step % training.save_every == 0:
                trainer.save(folder, card)
            if progress is not None:
                progress(trainer.next_step, training.steps)
    trainer.save(folder, card)
    return MotionEncoder.load(folder)


@torch.no_grad()
def explained(model: MotionEncoder, clips: Sequence[Float[Tensor, "t c"]]) -> float:
    """Share of the features' variance (in spreads, parts alike) that comes back from the latents; 1 is all."""
    weights, error, total = part_weights(model.config.features), 0.0, 0.0
    for clip in clips:
        whole = len(clip) - len(clip) % model.frames_per_latent
        if whole:
            seen = model.normalize(clip[None, :whole])
            error += float(((model(seen) - seen) ** 2 * weights).sum())
            total += float((seen**2 * weights).sum())
    return 1 - error / max(total, 1e-12)
