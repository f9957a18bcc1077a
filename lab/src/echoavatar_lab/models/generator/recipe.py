"""How a generator is trained: the three stages of the paper's curriculum are choices here."""

from typing import Literal

from pydantic import Field

from echoavatar_lab.training import TrainingConfig


class GeneratorTraining(TrainingConfig):
    """The defaults suit a small model from scratch on a CPU.

    Paper, Audio Driven Motion Generation. Stage 1, Embedding Space Alignment: `objective` "streams". Stage 2,
    Acoustic-Kinematic Alignment: the default. Stage 3, Exemplar-Driven Control: `exemplar` above 0.
    """

    steps: int = Field(default=3000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=8, gt=0, description="windows per step")
    chunks: int = Field(
        default=24, gt=0, description="chunks per window; more than window_chunks trains the steady stream"
    )
    objective: Literal["motion", "streams"] = Field(
        default="motion",
        description="motion codes from sound and motion; or (paper, stage 1) the next code of sound alone and of "
        "motion alone, of which the embeddings learn while the body is frozen",
    )
    learning_rate: float = Field(
        default=1e-3, gt=0, description="peak of the schedule (paper: 5e-5 from Qwen's weights)"
    )
    weight_decay: float = Field(default=0.05, ge=0, description="AdamW decay of matrices")
    betas: tuple[float, float] = Field(default=(0.9, 0.95), description="AdamW's averages")
    optimiser: Literal["adamw", "muon"] = Field(
        default="adamw", description="paper: AdamW; Muon takes the layers' matrices and learns in fewer steps"
    )
    depth_weights: tuple[float, ...] = Field(default=(1.0, 0.7, 0.5, 0.35), description="loss weight of each RVQ layer")
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
    asked: float = Field(
        default=1.0,
        gt=0,
        le=1,
        description="depth order: share of the frames of a window whose codes are asked for; all are heard and read, "
        "so that the backbone sees more motion in the same time (not in the paper)",
    )
    out_of_step: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows whose context motion drifts up to 3 tokens early or late (not in the paper)",
    )
    other_past: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows whose context motion is another window's up to a random token, as when the body"
        " still talks while music plays: the sound must tell (not in the paper)",
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
