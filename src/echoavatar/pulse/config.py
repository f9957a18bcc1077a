"""Sizes of the pulse model, and how it is trained."""

from pydantic import Field

from ..config import Config
from ..face import MelConfig
from ..timing import CHUNK_FRAMES
from ..training import TrainingConfig


class PulseConfig(Config):
    """The mel encoder that the face has too, with two seconds of past: a beat is told by those before it."""

    encoder: MelConfig = Field(default=MelConfig(width=96, past=15), description="what it hears with")
    sharpness: float = Field(
        default=2.0,
        gt=0,
        description="by which logits are multiplied when used: half a dip in time helps little",
    )
    eagerness: float = Field(default=1.0, description="added to them then: a dip too many costs little")


class PulseTraining(TrainingConfig):
    """How a pulse model is trained."""

    steps: int = Field(default=2000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=24, gt=0, description="windows per step")
    frames: int = Field(default=128, gt=0, multiple_of=CHUNK_FRAMES, description="frames per window")
    learning_rate: float = Field(default=2e-3, gt=0, description="peak of the schedule")
    gain_db: float = Field(default=6.0, ge=0, description="windows are made louder or softer by up to this")
