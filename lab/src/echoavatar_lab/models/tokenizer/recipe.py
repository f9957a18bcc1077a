"""How tokenizers are trained: the paper's schedule by default, and the default bundle's."""

from pydantic import Field

from echoavatar.models.tokenizer import BodyTokenizerConfig, MotionTokenizerConfig, body_config
from echoavatar.motion.kinematics import Skeleton
from echoavatar_lab.training import Schedule, TrainingConfig

from .losses import LossWeights


class TokenizerTraining(TrainingConfig):
    """Batch, schedule and losses (paper, appendix Motion Tokenizer Training Details)."""

    steps: int = Field(default=100_000, gt=0, description="optimiser steps")
    batch: int = Field(default=256, gt=0, description="windows per step")
    frames: int = Field(default=64, gt=0, description="frames per window")
    learning_rate: float = Field(default=2e-4, gt=0, description="peak (paper, Settings: 4e-4; the release: 2e-4)")
    schedule: Schedule = Field(default="step", description="course of the learning rate after the warm-up")
    warmup: int = Field(default=200, ge=0, description="steps of linear warm-up")
    temperature: float = Field(default=0.5, ge=0, description="Gumbel noise on the choice of codes")
    dropout: float = Field(default=0.2, ge=0, le=1, description="probability of using only the first RVQ layers")
    quantize_from: int = Field(default=0, ge=0, description="ours: steps before it as a plain auto-encoder")
    is_principal_start: bool = Field(default=False, description="ours: start as a principal component analysis")
    is_scaled_by_reach: bool = Field(default=False, description="ours: weigh joints by what hangs on them")
    is_mirrored: bool = Field(default=True, description="mirror half of the windows")
    evaluate_every: int = Field(default=500, ge=0, description="steps between measurements on test clips")
    log_every: int = Field(default=20, gt=0, description="steps between lines of metrics.jsonl")
    save_every: int = Field(default=0, ge=0, description="steps between checkpoints; 0: by the clock only")
    save_minutes: float = Field(default=3.0, ge=0, description="minutes between checkpoints")
    losses: LossWeights = Field(default=LossWeights(), description="loss weights")


def bundle_recipe(skeleton: Skeleton, steps: int) -> tuple[BodyTokenizerConfig, TokenizerTraining]:
    """Sizes and schedule of the default bundle: minutes on a CPU, streams on one core."""
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
    return body_config(skeleton, BUNDLE_SIZES), training


BUNDLE_SIZES = MotionTokenizerConfig(
    features=1, width=128, heads=4, layers=4, codes=512, decay=0.98, dead_below=0.05, kmeans_steps=8
)


def continued(training: TokenizerTraining) -> TokenizerTraining:
    """The recipe for going on from a trained tokenizer: codes keep roughly their meaning, so the rate is lower."""
    return training.model_copy(
        update={"learning_rate": training.learning_rate * 0.3, "quantize_from": 0, "is_principal_start": False}
    )
