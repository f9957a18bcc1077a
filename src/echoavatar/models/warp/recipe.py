"""Training settings of a warp model."""

from pydantic import Field

from echoavatar.timing import CHUNK_FRAMES
from echoavatar.training import TrainingConfig


class WarpTraining(TrainingConfig):
    """How a warp model is trained."""

    steps: int = Field(default=2000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=24, gt=0, description="windows per step")
    frames: int = Field(default=128, gt=0, multiple_of=CHUNK_FRAMES, description="frames per window")
    learning_rate: float = Field(default=2e-3, gt=0, description="peak of the schedule")
    gain_db: float = Field(default=6.0, ge=0, description="windows are made louder or softer by up to this")
