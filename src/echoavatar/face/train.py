"""Training of the face model: flow matching with audio dropout, resumable to the same curve.

Paper, Face Animation Generator: MSE flow matching, 10 % audio dropout, AdamW 2e-4, batch 128, windows of 64 frames,
300 000 iterations. Everything random in a step follows from the seed and the step's number. Departs from the paper: the
history that the model is shown is corrupted, so that it listens instead of copying the last frame, and the encoder,
which is not pretrained on other speech as HuBERT is, may learn alone at first.
"""

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from .. import checkpoint
from ..errors import CheckpointError
from .clip import FaceClip
from .config import FaceConfig, FaceTraining
from .losses import FaceReader, flow_loss
from .model import FaceModel
from .tempo import SPEEDS
from .windows import FaceSampler, levelled

RESUME = "resume.safetensors"


class FaceTrainer:
    """A model, its optimiser and the number of the next step."""

    def __init__(self, config: FaceConfig, training: FaceTraining, clips: Sequence[FaceClip]) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.model = FaceModel(config)
            self.reader = FaceReader(config.encoder.outputs, config.channels)
        chosen = [levelled(clip) for clip in clips if clip.split == "train"]
        self.sampler = FaceSampler(
            chosen,
            frames=training.frames,
            seed=training.seed,
            gain_db=training.gain_db,
            speeds=SPEEDS if training.tempo else (1.0,),
        )
        self.model.measure(torch.from_numpy(np.concatenate([clip.curves for clip in chosen])))
        self.training, self.next_step = training, 0
        learned = [*self.model.parameters(), *self.reader.parameters()]
        groups = [
            {"params": [p for p in learned if p.dim() > 1], "weight_decay": training.weight_decay},
            {"params": [p for p in learned if p.dim() <= 1], "weight_decay": 0.0},
        ]
        self._optimiser = torch.optim.AdamW(groups, lr=training.learning_rate, betas=(0.9, 0.98))

    def step(self) -> dict[str, float]:
        """One optimiser step; returns its metrics."""
        training, number = self.training, self.next_step
        random = torch.Generator().manual_seed(training.seed * 1_000_003 + number)
        for group in self._optimiser.param_groups:
            group["lr"] = self._rate(number)
        batch = self.sampler.batch(number, training.batch)
        features = self.model.encoder(batch.audio)
        read = self.reader.loss(self.model, features, batch.curves)
        if number < training.listen:
            loss = read
        else:
            loss = flow_loss(self.model, batch, training, random, features=features) + training.readout * read
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        learned = [p for p in [*self.model.parameters(), *self.reader.parameters()] if p.grad is not None]
        norm = nn.utils.clip_grad_norm_(learned, training.clip)
        self._optimiser.step()
        self.next_step += 1
        return {"step": number, "loss": loss.item(), "read": read.item(), "gradient": norm.item()}

    def _rate(self, number: int) -> float:
        """Warm-up and a cosine, of the listening steps and of the others each."""
        training, listen = self.training, self.training.listen
        if number < listen:
            peak, done, steps = training.listening_rate, number, listen
        else:
            peak, done, steps = training.learning_rate, number - listen, training.steps - listen
        warm = min(1.0, (done + 1) / max(1, training.warmup))
        cosine = 0.5 * (1 + math.cos(math.pi * min(1.0, done / max(1, steps))))
        return peak * warm * (training.final_rate + (1 - training.final_rate) * cosine)

    def save(self, folder: Path, card: Mapping[str, object] | None = None) -> None:
        """Write everything a resumed run needs as one file, at once or not at all; then the model as a checkpoint."""
        state = {
            f"model.{key}": value.detach().contiguous() for key, value in self.model.state_dict().items()
        }
        state |= {f"reader.{key}": value.contiguous() for key, value in self.reader.state_dict().items()}
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
        for name, module in (("model.", self.model), ("reader.", self.reader)):
            weights = {key[len(name) :]: value for key, value in tensors.items() if key.startswith(name)}
            checkpoint.load_into(module, weights, origin=str(path))
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
