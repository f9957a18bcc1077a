"""Training settings of the finger model; the paper (Motion Refinement) gives none."""

from pydantic import Field

from echoavatar_lab.training import TrainingConfig


class FingerTraining(TrainingConfig):
    """Schedule, data mix and noise of finger training."""

    steps: int = Field(default=3000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=32, gt=0, description="windows per step")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule")
    final_rate: float = Field(default=0.03, ge=0, le=1, description="share of the peak at the end of the cosine")
    betas: tuple[float, float] = Field(default=(0.9, 0.98), description="AdamW's decay rates")
    recorded: float = Field(
        default=0.3, ge=0, le=1, description="share of windows from recorded clips, if there are any"
    )
    one_known: float = Field(default=0.25, ge=0, le=1, description="share of windows with one hand given")
    pure_noise: float = Field(default=0.3, ge=0, le=1, description="share of windows with pure noise")
    body_noise: float = Field(
        default=0.15, ge=0, description="largest deviation of the noise on body features, in standard deviations"
    )
    body_offset: float = Field(
        default=0.5,
        ge=0,
        description="the same for an offset that is constant over a window, which stands for other people and rigs",
    )
    speed_weight: float = Field(default=10.0, ge=0, description="weight of the error of frame-to-frame differences")
