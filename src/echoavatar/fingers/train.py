"""Training of the finger model on motion with good fingers, resumable to the same curve.

Paper, Motion Refinement: trained on the fingers of ZeroEGGS, which may not train weights that are passed on; ours
learns from clips of two kinds, many made by rule and few recorded, in a fixed share. Everything random in a step
follows from the seed and the step's number.
"""

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from .. import checkpoint
from ..errors import CheckpointError, MotionError
from .body import mirror_body
from .clips import FingerClip
from .config import FingerConfig, FingerTraining
from .hands import fit_basis
from .model import FingerModel
from .windows import FingerSampler, denoising_loss

RESUME = "resume.safetensors"


class FingerTrainer:
    """A model, its optimiser and the number of the next step."""

    def __init__(
        self,
        config: FingerConfig,
        training: FingerTraining,
        clips: Sequence[FingerClip],
        recorded: Sequence[FingerClip] = (),
    ) -> None:
        """Raises MotionError when no clip has moving fingers."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.model = FingerModel(config)
        groups = [[clip for clip in group if clip.is_alive.any()] for group in (clips, recorded)]
        shares = [1 - training.recorded if groups[1] else 1.0, training.recorded]
        pairs = [(group, share) for group, share in zip(groups, shares, strict=True) if group]
        if not pairs:
            raise MotionError("no clip has fingers that move; give clips with good fingers")
        groups, shares = [group for group, _ in pairs], [share for _, share in pairs]
        _measure(self.model, groups)
        self.sampler = FingerSampler(self.model, groups, shares, seed=training.seed)
        self.training, self.next_step = training, 0
        parameters = list(self.model.parameters())
        decayed = {"params": [p for p in parameters if p.dim() > 1], "weight_decay": training.weight_decay}
        others = {"params": [p for p in parameters if p.dim() <= 1], "weight_decay": 0.0}
        self._optimiser = torch.optim.AdamW([decayed, others], lr=training.learning_rate, betas=(0.9, 0.98))

    def step(self) -> dict[str, float]:
        """One optimiser step; returns its metrics."""
        training, number = self.training, self.next_step
        random = torch.Generator().manual_seed(training.seed * 1_000_033 + number)
        for group in self._optimiser.param_groups:
            group["lr"] = training.learning_rate * self._schedule(number)
        loss = denoising_loss(self.model, self.sampler.batch(number, training.batch), training, random)
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
        about = {"kind": "fingers", "step": self.next_step, "training": self.training.model_dump()}
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
        if FingerConfig.model_validate_json(facts["config"]) != self.model.config:
            raise CheckpointError(
                f"{folder} holds a finger model of another config; train into another folder"
            )
        if FingerTraining.model_validate_json(facts["training"]) != self.training:
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


def train_fingers(
    config: FingerConfig,
    training: FingerTraining,
    clips: Sequence[FingerClip],
    folder: Path,
    *,
    recorded: Sequence[FingerClip] = (),
    minutes: float | None = None,
    card: Mapping[str, object] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FingerModel:
    """Train, checkpointing into `folder` with `card`; continues what is there.

    Stops after the schedule's steps, or after `minutes` of this call; metrics go to `folder`/metrics.jsonl.
    """
    trainer = FingerTrainer(config, training, clips, recorded)
    trainer.resume(folder)
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
    return FingerModel.load(folder)


def _measure(model: FingerModel, groups: Sequence[Sequence[FingerClip]]) -> None:
    """Statistics in which every group has the same say, however long its clips."""
    alive = [torch.cat([clip.hands[:, clip.is_alive].flatten(0, 1) for clip in group]) for group in groups]
    bodies = [torch.cat([clip.body for clip in group]) for group in groups]
    hands, body = torch.cat(_evened(alive)), torch.cat(_evened(bodies))
    body = torch.cat([body, mirror_body(body)])
    model.measure(fit_basis(hands, model.config.poses), body.mean(0), body.std(0))


def _evened(groups: Sequence[Tensor]) -> list[Tensor]:
    """As many rows of each, evenly spaced: those of the longest, 20,000 at most."""
    count = min(20_000, max(len(rows) for rows in groups))
    return [rows[torch.linspace(0, len(rows) - 1, count).long()] for rows in groups]
