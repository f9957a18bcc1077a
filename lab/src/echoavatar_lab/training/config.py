"""Settings that all training tasks share: batch, schedule, optimiser, checkpoints. Each task's config adds its own."""

import math
from typing import Literal

import torch
from pydantic import Field

from echoavatar.config import Config

Schedule = Literal["constant", "cosine", "step"]


class TrainingConfig(Config):
    """How to train. `batch` is the size of one optimiser step, however many processes and pieces share it."""

    steps: int = Field(default=1000, gt=0, description="optimiser steps of the whole schedule")
    minutes: float = Field(default=0.0, ge=0, description="training time, the schedule fitted to it; 0: no limit")
    batch: int = Field(default=8, gt=0, description="rows per optimiser step, of all processes together")
    accumulation: int = Field(
        default=1, gt=0, description="pieces that a process splits its rows into; changes memory, not the result"
    )
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule")
    schedule: Schedule = Field(default="cosine", description="shape of the learning rate after the warm-up")
    warmup: int = Field(default=100, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(
        default=0.05, ge=0, le=1, description="cosine: share of the peak at the end of the schedule"
    )
    decay_at: tuple[float, ...] = Field(
        default=(0.5, 0.8), description="step: shares of the run after which the rate drops"
    )
    decay_factor: float = Field(default=0.1, gt=0, le=1, description="step: factor of each drop")
    weight_decay: float = Field(default=0.01, ge=0, description="AdamW's weight decay")
    betas: tuple[float, float] = Field(default=(0.9, 0.99), description="AdamW's betas")
    clip: float = Field(default=1.0, gt=0, description="largest norm of the gradient")
    average: float = Field(
        default=0.0, ge=0, lt=1, description="decay of the averaged weights that are saved; 0: no averaging"
    )
    autocast: bool = Field(default=False, description="multiply in bfloat16 on processors that are fast at it")
    seed: int = Field(default=0, description="seed of weights and of everything random in a step")
    log_every: int = Field(default=1, gt=0, description="steps between lines of metrics.jsonl")
    evaluate_every: int = Field(default=0, ge=0, description="steps between evaluations; 0: none during the run")
    save_every: int = Field(default=200, ge=0, description="steps between checkpoints; 0: by time only")
    save_minutes: float = Field(default=0.0, ge=0, description="minutes between checkpoints; 0: by steps only")

    def noise(self, step: int, salt: int = 0) -> torch.Generator:
        """A generator for everything random in a step; it depends only on seed, step and salt."""
        return torch.Generator().manual_seed(self.seed * 1_000_003 + step + salt)

    def rate_at(self, step: int, done: float | None = None) -> float:
        """Learning rate of a step; `done` is the share of the run completed, by default counted in steps."""
        done = min(1.0, step / self.steps) if done is None else done
        return self.learning_rate * min(1.0, (step + 1) / max(1, self.warmup)) * self.decayed(done)

    def decayed(self, done: float) -> float:
        """Share of the peak rate that is left when a share of the run is done."""
        if self.schedule == "cosine":
            return self.final_rate + (1 - self.final_rate) * 0.5 * (1 + math.cos(math.pi * done))
        if self.schedule == "step":
            return self.decay_factor ** sum(done >= share for share in self.decay_at)
        return 1.0
