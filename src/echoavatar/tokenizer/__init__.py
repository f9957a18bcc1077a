"""Motion to codes and back: one causal attention RVQ-VAE per body part. May import `data` and below."""

from .body import BodyState, BodyTokenizer, BodyTokenizerConfig, body_config
from .losses import LossWeights, MotionLoss
from .measure import TokenizerScores, measure
from .model import DecoderState, EncoderState, MotionTokenizer, MotionTokenizerConfig, TokenizerPass
from .train import TokenizerTraining, bundle_recipe, train_tokenizer
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
    "TokenizerTraining",
    "body_config",
    "bundle_recipe",
    "clip_features",
    "measure",
    "train_tokenizer",
]
