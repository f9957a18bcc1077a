"""Motion to codes and back: one causal attention RVQ-VAE per body part. May import `data` and below.

Training is `tokenizer.train`, imported by name, so that what only streams never loads it.
"""

from .body import BodyState, BodyTokenizer, BodyTokenizerConfig, as_one_part, body_config
from .losses import LossWeights, MotionLoss
from .measure import TokenizerScores, measure
from .model import DecoderState, EncoderState, MotionTokenizer, MotionTokenizerConfig, TokenizerPass
from .windows import clip_features

__all__ = [
    "BodyState",
    "BodyTokenizer",
    "BodyTokenizerConfig",
    "DecoderState",
    "EncoderState",
    "LossWeights",
    "MotionLoss",
    "MotionTokenizer",
    "MotionTokenizerConfig",
    "TokenizerPass",
    "TokenizerScores",
    "as_one_part",
    "body_config",
    "clip_features",
    "measure",
]
