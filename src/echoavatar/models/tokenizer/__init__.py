"""Motion to codes and back: one causal attention RVQ-VAE per body part. May import `motion` and below."""

from .body import BodyTokenizer, BodyTokenizerConfig, as_one_part, body_config
from .model import MotionTokenizer, MotionTokenizerConfig

__all__ = [
    "BodyTokenizer",
    "BodyTokenizerConfig",
    "MotionTokenizer",
    "MotionTokenizerConfig",
    "as_one_part",
    "body_config",
]
