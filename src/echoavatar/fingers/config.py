"""Sizes and training of the finger model. The paper (Motion Refinement) gives no numbers; these suit a CPU."""

from typing import Self

from pydantic import Field, model_validator

from ..config import Config
from .hands import HAND_SIZE


class FingerConfig(Config):
    """A small transformer that sees all of a window at once."""

    frames: int = Field(default=64, gt=0, description="frames of a window, at 30 per second")
    patch: int = Field(default=4, gt=0, description="frames that share a token; must divide the window")
    width: int = Field(default=128, gt=0, description="channels")
    layers: int = Field(default=3, gt=0, description="transformer blocks")
    heads: int = Field(default=4, gt=0, description="attention heads")
    poses: int = Field(
        default=24, gt=0, le=HAND_SIZE, description="directions in which one hand's pose varies"
    )

    @model_validator(mode="after")
    def _sizes_fit(self) -> Self:
        if self.frames % self.patch:
            raise ValueError(f"patch ({self.patch}) must divide frames ({self.frames})")
        if self.width % (2 * self.heads):
            raise ValueError(f"width ({self.width}) must be a multiple of twice the heads ({self.heads})")
        return self


class FingerTraining(Config):
    """How a finger model is trained."""

    steps: int = Field(default=3000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=32, gt=0, description="windows per step")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule")
    warmup: int = Field(default=100, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(
        default=0.03, ge=0, le=1, description="share of the peak at the end of the cosine"
    )
    weight_decay: float = Field(default=0.01, ge=0, description="AdamW decay of matrices")
    clip: float = Field(default=1.0, gt=0, description="largest norm of the gradient")
    recorded: float = Field(
        default=0.3, ge=0, le=1, description="share of windows from recorded clips, where there are any"
    )
    one_known: float = Field(default=0.25, ge=0, le=1, description="share of windows with one hand given")
    pure_noise: float = Field(default=0.3, ge=0, le=1, description="share of windows of nothing but noise")
    body_noise: float = Field(
        default=0.15, ge=0, description="largest deviation of the noise on a window's body, in its spreads"
    )
    body_offset: float = Field(
        default=0.5,
        ge=0,
        description="the same for what a whole window's body is off by: other people, other rigs, other postures",
    )
    speed_weight: float = Field(default=10.0, ge=0, description="weight of the error from frame to frame")
    seed: int = Field(default=0, description="of weights, windows, noise")
    save_every: int = Field(default=200, gt=0, description="steps between checkpoints")
