"""Training on tokenised clips: hierarchical loss scaling, Hierarchical Token Corruption, resumable to the same curve.

Paper, Audio Driven Motion Generation. Everything random in a step follows from the seed and the step's number, so a run
that was killed and resumed repeats the curve it would have had.
"""

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from pydantic import Field
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from .. import checkpoint
from ..config import Config
from ..errors import CheckpointError
from ..tokens import Sequences, corrupt_hierarchically, corrupt_uniformly
from .config import GeneratorConfig
from .cues import CueReader
from .exemplar import Exemplar, draw_exemplar
from .initial import align_embeddings
from .loss import code_nll, hierarchical_loss, summary, to_device
from .model import Generator
from .windows import TokenClip, Window, WindowSampler

RESUME = "resume.safetensors"


class GeneratorTraining(Config):
    """How a generator is trained. The defaults suit a small model from scratch on a CPU."""

    steps: int = Field(default=3000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=8, gt=0, description="windows per step")
    chunks: int = Field(
        default=24, gt=0, description="chunks per window; more than window_chunks trains the steady stream"
    )
    learning_rate: float = Field(
        default=1e-3, gt=0, description="peak of the schedule (paper: 5e-5 from Qwen's weights)"
    )
    warmup: int = Field(default=100, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(
        default=0.05, ge=0, le=1, description="share of the peak at the end of the cosine"
    )
    weight_decay: float = Field(default=0.05, ge=0, description="AdamW decay of matrices")
    optimiser: Literal["adamw", "muon"] = Field(
        default="adamw", description="paper: AdamW; Muon takes the layers' matrices and learns in fewer steps"
    )
    clip: float = Field(default=1.0, gt=0, description="largest norm of the gradient")
    depth_weights: tuple[float, ...] = Field(
        default=(1.0, 0.7, 0.5, 0.35), description="loss weight of each RVQ layer"
    )
    corruption: Literal["hierarchical", "uniform", "none"] = Field(
        default="hierarchical", description="what is done to the context motion codes"
    )
    corruption_low: float = Field(default=0.0, ge=0, le=1, description="smallest corruption rate of a window")
    corruption_high: float = Field(default=0.5, ge=0, le=1, description="largest; the paper gives no rate")
    blind: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows whose context motion is all noise: the sound must tell (not in the paper)",
    )
    out_of_step: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows whose context motion runs 1 or 2 tokens early or late (not in the paper)",
    )
    exemplar: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows that are told a set of their own first-layer upper codes (paper, stage 3)",
    )
    cue_weight: float = Field(
        default=0.0,
        ge=0,
        description="weight of telling beats and stresses half-way up, where known (`cues`; not in the paper)",
    )
    short_windows: float = Field(
        default=0.2, ge=0, le=1, description="prefix order: share of windows cut short in front"
    )
    seed: int = Field(default=0, description="of weights, windows and corruption")
    autocast: bool = Field(
        default=False, description="bfloat16 products; faster on processors that have them"
    )
    save_every: int = Field(default=200, gt=0, description="steps between checkpoints")


class Trainer:
    """A generator, its optimiser and the number of the next step."""

    def __init__(
        self,
        config: GeneratorConfig,
        training: GeneratorTraining,
        *,
        device: str = "cpu",
        audio_codebooks: Float[Tensor, "l A a"] | None = None,
        motion_codebooks: Float[Tensor, "p q K c"] | None = None,
    ) -> None:
        if len(training.depth_weights) != config.layout.motion_layers:
            raise CheckpointError(
                f"depth_weights has {len(training.depth_weights)} values for {config.layout.motion_layers} RVQ layers"
            )
        if training.exemplar and not config.exemplar:
            raise CheckpointError("training exemplar > 0 needs a generator config with exemplar true")
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.generator = Generator(config)
            self.cues = CueReader(self.generator).to(device)
        align_embeddings(self.generator, audio_codebooks=audio_codebooks, motion_codebooks=motion_codebooks)
        self.generator.to(device)
        self.training, self.next_step, self._device = training, 0, device
        self._optimisers = _optimisers(self.generator, self.cues, training)

    def begin_with(self, start: Generator) -> None:
        """Take the weights of a trained generator; one without exemplar control lends it none."""
        weights = start.state_dict()
        if start.exemplar is None:
            own = self.generator.state_dict()
            weights |= {key: own[key] for key in own if key.startswith("exemplar.")}
        checkpoint.load_into(self.generator, weights, origin="the generator to start from")

    def step(self, window: Window) -> dict[str, Any]:
        """One optimiser step; returns its metrics."""
        training, number = self.training, self.next_step
        batch = self._corrupted(window, number)
        exemplar = self._exemplar(window, number)
        for optimiser in self._optimisers:
            for group in optimiser.param_groups:
                group["lr"] = training.learning_rate * self._schedule(number)
        with torch.autocast(torch.device(self._device).type, torch.bfloat16, enabled=training.autocast):
            hidden = self.generator.read(batch, exemplar)
            nll = code_nll(self.generator, batch, hidden, exemplar)
        loss = hierarchical_loss(nll, batch, training.depth_weights)
        cues = self.cues.loss(window.cues, batch.predictors) if training.cue_weight else torch.zeros(())
        for module in (self.generator, self.cues):
            module.zero_grad(set_to_none=True)
        (loss + training.cue_weight * cues).backward()  # type: ignore[no-untyped-call]
        norm = nn.utils.clip_grad_norm_(self.generator.parameters(), training.clip)
        for optimiser in self._optimisers:
            optimiser.step()
        self.next_step += 1
        told = {"step": number, "loss": loss.item(), "gradient": norm.item(), "cues": cues.item()}
        return told | summary(nll.detach(), batch, window, exemplar)

    def _exemplar(self, window: Window, number: int) -> Exemplar | None:
        """The step's directives, where the generator takes them."""
        if not self.training.exemplar:
            return None
        random = torch.Generator().manual_seed(self.training.seed * 1_000_003 + number + 500_009)
        config = self.generator.config
        whole, codes = config.sequence == "prefix", config.layout.motion_codes
        drawn = draw_exemplar(
            window.motion, self.training.exemplar, codes=codes, whole=whole, generator=random
        )
        return Exemplar(*(tensor.to(self._device) for tensor in drawn))

    def _schedule(self, number: int) -> float:
        training = self.training
        warm = min(1.0, (number + 1) / max(1, training.warmup))
        done = min(1.0, number / training.steps)
        return warm * (training.final_rate + (1 - training.final_rate) * 0.5 * (1 + math.cos(math.pi * done)))

    def _corrupted(self, window: Window, number: int) -> Sequences:
        """The step's sequences: context corrupted, targets clean."""
        training, config = self.training, self.generator.config
        random = torch.Generator().manual_seed(training.seed * 1_000_003 + number)
        rows, context = len(window.motion), window.motion
        if training.out_of_step:
            context = _out_of_step(context, training.out_of_step, random)
        low, high = training.corruption_low, training.corruption_high
        rates = low + (high - low) * torch.rand(rows, generator=random)
        codebook = config.layout.motion_codes
        if training.corruption == "hierarchical":
            context = corrupt_hierarchically(context, rates, codebook=codebook, generator=random)
        elif training.corruption == "uniform":
            context = corrupt_uniformly(context, rates, codebook=codebook, generator=random)
        if training.blind:
            blind = (torch.rand(rows, generator=random) < training.blind).float()
            context = corrupt_uniformly(context, blind, codebook=codebook, generator=random)
        missing = torch.zeros(rows, dtype=torch.int64)
        if config.sequence == "prefix":
            cut = torch.rand(rows, generator=random) < training.short_windows
            missing = torch.randint(training.chunks, (rows,), generator=random) * cut
        return to_device(config.order.build(window.audio, context, window.motion, missing), self._device)

    def save(self, folder: Path) -> None:
        """Write everything a resumed run needs as one file, at once or not at all; then the model as a checkpoint."""
        state = {
            f"model.{key}": value.detach().contiguous() for key, value in self.generator.state_dict().items()
        }
        for which, optimiser in enumerate(self._optimisers):
            for index, values in optimiser.state_dict()["state"].items():
                state |= {f"optimiser.{which}.{index}.{name}": v.contiguous() for name, v in values.items()}
        state |= {f"cues.{key}": value.detach() for key, value in self.cues.state_dict().items()}
        facts = {"step": str(self.next_step), "training": self.training.model_dump_json()}
        folder.mkdir(parents=True, exist_ok=True)
        partial = folder / f"{RESUME}.partial"
        save_file(state, partial, metadata=facts | {"config": self.generator.config.model_dump_json()})
        partial.replace(folder / RESUME)
        card = {"kind": "generator", "step": self.next_step, "training": self.training.model_dump()}
        self.generator.save(folder, card)

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
        if GeneratorConfig.model_validate_json(facts["config"]) != self.generator.config:
            raise CheckpointError(f"{folder} holds a generator of another config; train into another folder")
        if GeneratorTraining.model_validate_json(facts["training"]) != self.training:
            raise CheckpointError(f"{folder} was trained with other settings; train into another folder")
        weights = {key[len("model.") :]: value for key, value in tensors.items() if key.startswith("model.")}
        checkpoint.load_into(self.generator, weights, origin=str(path))
        reader = {key[len("cues.") :]: tensors[key] for key in tensors if key.startswith("cues.")}
        checkpoint.load_into(self.cues, reader, origin=str(path))
        for which, optimiser in enumerate(self._optimisers):
            prefix, stored = f"optimiser.{which}.", defaultdict[int, dict[str, Tensor]](dict)
            for key in (key for key in tensors if key.startswith(prefix)):
                index, name = key[len(prefix) :].split(".", 1)
                stored[int(index)][name] = tensors[key]
            groups = optimiser.state_dict()["param_groups"]
            optimiser.load_state_dict({"state": dict(stored), "param_groups": groups})
        self.next_step = int(facts["step"])
        return True


def train_generator(
    config: GeneratorConfig,
    training: GeneratorTraining,
    clips: Sequence[TokenClip],
    folder: Path,
    *,
    minutes: float | None = None,
    device: str = "cpu",
    audio_codebooks: Float[Tensor, "l A a"] | None = None,
    motion_codebooks: Float[Tensor, "p q K c"] | None = None,
    start: Generator | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Generator:
    """Train on the clips of split "train", checkpointing into `folder`; continues what is there.

    A new run begins with the weights of `start`, where given, under a schedule of its own. Stops after the schedule's
    steps, or after `minutes` of this call; metrics go to `folder`/metrics.jsonl.
    """
    trainer = Trainer(
        config, training, device=device, audio_codebooks=audio_codebooks, motion_codebooks=motion_codebooks
    )
    if not trainer.resume(folder) and start is not None:
        trainer.begin_with(start)
    chunks = training.chunks if config.sequence == "interleaved" else config.window_chunks
    sampler = WindowSampler([c for c in clips if c.split == "train"], chunks=chunks, seed=training.seed)
    folder.mkdir(parents=True, exist_ok=True)
    log = _truncated_log(folder / "metrics.jsonl", trainer.next_step)
    deadline = math.inf if minutes is None else time.monotonic() + 60 * minutes
    trainer.generator.train()
    with log.open("a") as out:
        while trainer.next_step < training.steps and time.monotonic() < deadline:
            began = time.monotonic()
            metrics = trainer.step(sampler.batch(trainer.next_step, training.batch))
            out.write(json.dumps(metrics | {"seconds": round(time.monotonic() - began, 3)}) + "\n")
            out.flush()
            if trainer.next_step % training.save_every == 0:
                trainer.save(folder)
            if progress is not None:
                progress(trainer.next_step, training.steps)
    trainer.save(folder)
    return trainer.generator.eval()


def _out_of_step(
    motion: Int[Tensor, "b n p q"], share: float, random: torch.Generator
) -> Int[Tensor, "b n p q"]:
    """A share of the rows moved by 1 or 2 tokens in time, so that only the sound tells the phase."""
    chosen = torch.rand(len(motion), generator=random) < share
    by = torch.tensor([-2, -1, 1, 2])[torch.randint(4, (len(motion),), generator=random)]
    rows = [
        row.roll(int(step), 0) if moves else row for row, step, moves in zip(motion, by, chosen, strict=True)
    ]
    return torch.stack(rows)


def _optimisers(
    generator: Generator, cues: nn.Module, training: GeneratorTraining
) -> list[torch.optim.Optimizer]:
    """AdamW over everything; or Muon over the layers' matrices and AdamW over embeddings, heads, norms and biases."""
    muon = training.optimiser == "muon"
    inner = [p for p in generator.model.layers.parameters() if p.dim() == 2 and muon]
    taken = {id(p) for p in inner}
    rest = [p for p in (*generator.parameters(), *cues.parameters()) if id(p) not in taken]
    rate, decay = training.learning_rate, training.weight_decay
    groups = [
        {"params": [p for p in rest if p.dim() > 1], "weight_decay": decay},
        {"params": [p for p in rest if p.dim() == 1], "weight_decay": 0.0},
    ]
    found: list[torch.optim.Optimizer] = [torch.optim.AdamW(groups, lr=rate, betas=(0.9, 0.95), fused=True)]
    if inner:  # matched to AdamW's step size, one rate serves both
        found.append(torch.optim.Muon(inner, lr=rate, weight_decay=decay, adjust_lr_fn="match_rms_adamw"))
    return found


def _truncated_log(path: Path, steps: int) -> Path:
    """Drop the lines of steps that a resumed run will repeat."""
    if path.exists():
        kept = [line for line in path.read_text().splitlines() if line and json.loads(line)["step"] < steps]
        path.write_text("".join(line + "\n" for line in kept))
    return path
