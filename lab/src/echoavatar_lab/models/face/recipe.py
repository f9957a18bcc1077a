"""How a face model is trained."""

from pydantic import Field

from echoavatar.timing import CHUNK_FRAMES
from echoavatar_lab.training import TrainingConfig


class FaceTraining(TrainingConfig):
    """How a face model is trained. The defaults suit a small model on a CPU; the paper's numbers are in the text."""

    steps: int = Field(default=8000, gt=0, description="optimiser steps of the whole schedule (paper: 300,000)")
    batch: int = Field(default=32, gt=0, description="windows per step (paper: 128)")
    betas: tuple[float, float] = Field(default=(0.9, 0.98), description="AdamW's averages")
    frames: int = Field(default=64, gt=0, multiple_of=CHUNK_FRAMES, description="frames per window (paper: 64)")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule (paper: 2e-4, constant)")
    audio_dropout: float = Field(default=0.1, ge=0, le=1, description="share of windows without sound (paper: 0.1)")
    history_noise: float = Field(
        default=1.5, ge=0, description="largest deviation of the noise on a window's history; 0 as in the paper"
    )
    history_dropout: float = Field(
        default=0.3, ge=0, le=1, description="share of windows whose history is the mean face; 0 as in the paper"
    )
    gain_db: float = Field(default=6.0, ge=0, description="windows are made louder or softer by up to this")
    high_noise: float = Field(
        default=2.0,
        ge=1,
        description="noise levels are u^(1 / this), u uniform: high noise makes sound tell; 1 is uniform",
    )
    lips: float = Field(
        default=0.3,
        ge=0,
        description="weight of the error of the lips' opening, four times where they touch; 0 as in the paper",
    )
    listen: int = Field(
        default=0, ge=0, description="first steps, in which the encoder alone learns, by a readout of the face; cheap"
    )
    listening_rate: float = Field(default=2e-3, gt=0, description="peak of their schedule")
    readout: float = Field(
        default=0.3, ge=0, description="weight of that readout's error in the steps that follow; 0 as in the paper"
    )
    tempo: bool = Field(
        default=True, description="clips also a tenth slower and faster (paper), which triples what is kept of them"
    )
    draws: int = Field(default=2, gt=0, description="noise levels per frame and step")
