"""How a finger model is trained. The paper (Motion Refinement) gives no numbers; these suit a CPU."""

from pydantic import Field

from ..training import TrainingConfig


class FingerTraining(TrainingConfig):
    """How a finger model is trained."""

    steps: int = Field(default=3000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=32, gt=0, description="windows per step")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule")
    final_rate: float = Field(
        default=0.03, ge=0, le=1, description="share of the peak at the end of the cosine"
    )
    betas: tuple[float, float] = Field(default=(0.9, 0.98), description="AdamW's averages")
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
