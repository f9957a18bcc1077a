"""Tokenizer training: 64-frame windows, AdamW with step decay (paper, appendix Motion Tokenizer Training Details).

The three parts train together, one window of the whole body a row. Killed runs go on to the same loss curve. Everything
is float32: the networks are small and run on CPUs, few of which are faster in bfloat16.
"""

import json
import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from pydantic import Field
from torch import Tensor, nn

from .. import checkpoint
from ..config import Config
from ..kinematics import Skeleton, split_parts
from .body import BodyTokenizer, BodyTokenizerConfig, body_config
from .losses import LossWeights, MotionLoss, total
from .measure import TokenizerScores, measure
from .model import MotionTokenizer, MotionTokenizerConfig, TokenizerPass
from .start import start_from_principal_axes
from .training_state import STATE_NAME, load_training, save_training
from .windows import MovingBody, WindowSampler, clip_features, floored_statistics, reach_statistics

START_WINDOWS = 400  # windows the principal axes are taken from
START_BATCHES = 12  # how many batches the codebooks are taken from after a start as an auto-encoder
log = logging.getLogger(__name__)


class TokenizerTraining(Config):
    """How to train; losses, batch and schedule."""

    steps: int = Field(default=100_000, gt=0, description="optimiser steps")
    batch: int = Field(default=256, gt=0, description="windows per step")
    frames: int = Field(default=64, gt=0, description="frames per window")
    learning_rate: float = Field(default=2e-4, gt=0, description="AdamW's peak rate")
    warmup: int = Field(default=200, ge=0, description="steps of linear warm-up")
    decay_at: tuple[float, ...] = Field(
        default=(0.5, 0.8), description="shares of the run at which the rate drops"
    )
    decay_factor: float = Field(default=0.1, gt=0, le=1, description="by how much it drops")
    weight_decay: float = Field(default=0.01, ge=0, description="AdamW's decay")
    betas: tuple[float, float] = Field(default=(0.9, 0.99), description="AdamW's averages")
    gradient_norm: float = Field(default=1.0, gt=0, description="gradients are clipped to this norm")
    temperature: float = Field(default=0.5, ge=0, description="Gumbel noise on the choice of codes")
    dropout: float = Field(
        default=0.2, ge=0, le=1, description="probability of using only the first RVQ layers"
    )
    quantize_from: int = Field(default=0, ge=0, description="ours: steps before it as a plain auto-encoder")
    is_principal_start: bool = Field(
        default=False, description="ours: start as a principal component analysis"
    )
    is_scaled_by_reach: bool = Field(default=False, description="ours: weigh joints by what hangs on them")
    is_mirrored: bool = Field(default=True, description="mirror half of the windows")
    seed: int = Field(default=0, description="seed of everything random")
    evaluate_every: int = Field(default=500, gt=0, description="steps between measurements on test clips")
    log_every: int = Field(default=20, gt=0, description="steps between lines of metrics.jsonl")
    checkpoint_minutes: float = Field(default=3.0, ge=0, description="minutes between training checkpoints")
    losses: LossWeights = Field(default=LossWeights(), description="loss weights")

    def rate_at(self, step: int) -> float:
        """Learning rate of a step: warm-up, then a drop at each share of the run."""
        drops = sum(step >= share * self.steps for share in self.decay_at)
        return self.learning_rate * min(1.0, (step + 1) / max(self.warmup, 1)) * self.decay_factor**drops


def bundle_recipe(skeleton: Skeleton, steps: int) -> tuple[BodyTokenizerConfig, TokenizerTraining]:
    """Sizes and schedule of the default bundle: minutes on a CPU, streams on one core."""
    template = MotionTokenizerConfig(
        features=1, width=128, heads=4, layers=4, codes=512, decay=0.98, dead_below=0.05, kmeans_steps=8
    )
    training = TokenizerTraining(
        steps=steps,
        batch=24,
        learning_rate=1.5e-3,
        warmup=100,
        decay_at=(0.6, 0.8, 0.92),
        decay_factor=0.4,
        temperature=0.0,
        dropout=0.0,
        quantize_from=min(steps // 10, 100),
        is_principal_start=True,
        is_scaled_by_reach=True,
        losses=LossWeights(position=0.05, travel=0.02, planted=0.3, root=0.5, fingers=0.1),
    )
    return body_config(skeleton, template), training


def continued(training: TokenizerTraining) -> TokenizerTraining:
    """The recipe for going on from a trained tokenizer: codes keep roughly their meaning, so the rate is lower."""
    return training.model_copy(
        update={
            "learning_rate": training.learning_rate * 0.3,
            "quantize_from": 0,
            "is_principal_start": False,
        }
    )


def train_tokenizer(
    config: BodyTokenizerConfig,
    training: TokenizerTraining,
    clips: Sequence[MovingBody],
    tests: Sequence[MovingBody],
    folder: Path,
    *,
    device: str = "cpu",
    card: dict[str, object] | None = None,
    start: BodyTokenizer | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> BodyTokenizer:
    """Train, or go on where a killed run stopped, and save the tokenizer in `folder`.

    Args:
        config: sizes and skeleton.
        training: schedule and losses.
        clips: motion to learn.
        tests: motion to measure on.
        folder: receives the checkpoint, `metrics.jsonl` and, while training, the training state.
        device: where to compute; random choices are made on the CPU everywhere.
        card: goes into `card.json` beside the scores.
        start: a trained tokenizer of the same sizes whose weights, codebooks and statistics a new run begins with.
        progress: called with (step, steps).

    Raises:
        MotionError: no clip is as long as a window.
        CheckpointError: the folder holds a training state of other sizes, or `start` is of other sizes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    run = TokenizerRun(config, training, clips, device=device)
    held_out = [clip_features(run.tokenizer.skeleton, clip) for clip in tests]
    if (folder / STATE_NAME).exists():
        load_training(folder, run.tokenizer, run.optimizer, run.generator, run)
    elif start is not None:
        checkpoint.load_into(run.tokenizer, start.state_dict(), origin="the tokenizer to start from")
    saved = time.monotonic()
    while run.step < training.steps:
        terms = run.advance()
        if run.step % training.log_every == 0:
            _write_metrics(folder, run.step, {"loss": terms, "rate": training.rate_at(run.step - 1)})
        if held_out and run.step % training.evaluate_every == 0 and run.step < training.steps:
            _write_metrics(folder, run.step, measure(run.tokenizer, held_out)._asdict())
        if time.monotonic() - saved > 60 * training.checkpoint_minutes:
            save_training(folder, run.tokenizer, run.optimizer, run.generator, run.step)
            saved = time.monotonic()
        if progress is not None:
            progress(run.step, training.steps)
    save_training(folder, run.tokenizer, run.optimizer, run.generator, run.step)
    _finish(run, held_out, folder, card or {})
    return run.tokenizer


class TokenizerRun:
    """A run in progress: model, optimiser, data, random numbers and the step it is at."""

    def __init__(
        self,
        config: BodyTokenizerConfig,
        training: TokenizerTraining,
        clips: Sequence[MovingBody],
        *,
        device: str = "cpu",
    ) -> None:
        self.training = training
        self.step = 0
        self.generator = torch.Generator().manual_seed(training.seed)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.tokenizer = BodyTokenizer(config)
        skeleton = self.tokenizer.skeleton
        features = [clip_features(skeleton, clip) for clip in clips]
        self.sampler = WindowSampler(
            skeleton, features, frames=training.frames, is_mirrored=training.is_mirrored
        )
        statistics = reach_statistics if training.is_scaled_by_reach else floored_statistics
        self.tokenizer.set_statistics(statistics(skeleton, features, is_mirrored=training.is_mirrored))
        if training.is_principal_start:
            self._start_from_principal_axes()
        self.tokenizer.to(device).train()
        self.loss = MotionLoss(skeleton, training.losses).to(device)
        self.optimizer = _optimizer(self.tokenizer, training)

    def advance(self) -> dict[str, float]:
        """One optimiser step; returns the loss terms."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.training.rate_at(self.step)
        if self.step == self.training.quantize_from > 0:
            self._initialise_codebooks()
        windows = self._draw()
        terms = self._terms(windows)
        self.optimizer.zero_grad(set_to_none=True)
        total(terms).backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.tokenizer.parameters(), self.training.gradient_norm)
        self.optimizer.step()
        self.step += 1
        return {name: float(value.detach()) for name, value in terms.items()}

    def _terms(self, windows: Tensor) -> dict[str, Tensor]:
        tokenizer, statistics = self.tokenizer, self.tokenizer.statistics
        truth = statistics.normalize(windows)
        sizes = [part.features for part in tokenizer.config.parts.values()]
        passes = [
            self._pass(part, x)
            for part, x in zip(tokenizer.tokenizers().values(), torch.split(truth, sizes, -1), strict=True)
        ]
        decoded = torch.cat([result.features for result in passes], -1)
        scale = torch.where(statistics.varies, statistics.std, 0.0)
        terms = self.loss(decoded, truth, mean=statistics.mean, std=scale)
        commitment = torch.stack([result.commitment for result in passes]).mean()
        terms["commitment"] = self.training.losses.commitment * commitment
        return dict(terms)

    def _pass(self, part: MotionTokenizer, x: Tensor) -> TokenizerPass:
        if self.step < self.training.quantize_from:
            none = torch.full((x.shape[0], 0, part.config.layers), -1)
            return TokenizerPass(part.from_latents(part.to_latents(x)), none, x.new_zeros(()))
        result: TokenizerPass = part(
            x,
            temperature=self.training.temperature,
            dropout=self.training.dropout,
            generator=self.generator,
        )
        return result

    def _start_from_principal_axes(self) -> None:
        generator = torch.Generator().manual_seed(self.training.seed)
        frames = self.sampler.draw(START_WINDOWS, generator).flatten(0, 1)
        normal = split_parts(self.tokenizer.skeleton, self.tokenizer.statistics.normalize(frames))
        for name, part in self.tokenizer.tokenizers().items():
            start_from_principal_axes(part, normal[name])

    def _draw(self) -> Tensor:
        return self.sampler.draw(self.training.batch, self.generator).to(self.tokenizer.mean)

    @torch.no_grad()
    def _initialise_codebooks(self) -> None:
        """From the latents of several batches, once the auto-encoder has found its feet."""
        parts = self.tokenizer.tokenizers()
        latents: dict[str, list[Tensor]] = {name: [] for name in parts}
        for _ in range(START_BATCHES):
            normal = self.tokenizer.statistics.normalize(self._draw())
            for name, x in split_parts(self.tokenizer.skeleton, normal).items():
                latents[name].append(parts[name].to_latents(x).flatten(0, 1))
        for name, part in parts.items():
            part.quantizer.initialise(torch.cat(latents[name]), self.generator)


def _optimizer(tokenizer: BodyTokenizer, training: TokenizerTraining) -> torch.optim.AdamW:
    return torch.optim.AdamW(
        tokenizer.parameters(),
        lr=training.learning_rate,
        betas=training.betas,
        weight_decay=training.weight_decay,
        fused=True,
    )


def _write_metrics(folder: Path, step: int, values: dict[str, object]) -> None:
    with (folder / "metrics.jsonl").open("a") as file:
        file.write(json.dumps({"step": step, "time": round(time.time(), 1), **values}) + "\n")


def _finish(
    run: TokenizerRun, tests: list[Tensor], folder: Path, card: dict[str, object]
) -> TokenizerScores | None:
    """Measure what will be shipped (half precision), and write it."""
    run.tokenizer.save(folder, card)
    shipped = BodyTokenizer.load(folder)
    scores = measure(shipped, tests) if tests else None
    full = {**card, "training": run.training.model_dump(), "scores": scores._asdict() if scores else {}}
    run.tokenizer.save(folder, full)
    if scores:
        _write_metrics(folder, run.step, scores._asdict())
        log.info("tokenizer: body %.1f mm, hands %.1f mm", scores.mpjpe_body_mm, scores.mpjpe_hands_mm)
    return scores
