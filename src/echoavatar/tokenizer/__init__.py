"""Motion to codes and back: one causal attention RVQ-VAE per body part. May import `data` and below."""

from .model import DecoderState, EncoderState, MotionTokenizer, MotionTokenizerConfig, TokenizerPass

__all__ = ["DecoderState", "EncoderState", "MotionTokenizer", "MotionTokenizerConfig", "TokenizerPass"]
