"""Vector quantisation: codebooks and residual stacks of them. May import `nn` and below."""

from .codebook import Codebook, Share
from .rvq import ResidualVectorQuantizer

__all__ = ["Codebook", "ResidualVectorQuantizer", "Share"]
