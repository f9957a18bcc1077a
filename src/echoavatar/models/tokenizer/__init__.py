"""Motion to codes and back: one causal attention RVQ-VAE per body part. May import `data` and below.

Training is `tokenizer.train`, imported by name, so that what only streams never loads it.
"""

from .body import BodyTokenizer, BodyTokenizerConfig, as_one_part, body_config
from .losses import LossWeights, MotionLoss
from .measure import measure
from .model import MotionTokenizer, MotionTokenizerConfig
from .windows import clip_features

__all__ = [
    "BodyTokenizer",
    "BodyTokenizerConfig",
    "LossWeights",
    "MotionLoss",
    "MotionTokenizer",
    "MotionTokenizerConfig",
    "as_one_part",
    "body_config",
    "clip_features",
    "measure",
]
