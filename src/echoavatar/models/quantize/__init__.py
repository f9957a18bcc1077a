"""Vector quantisation: codebooks, residual stacks of them, their usage. May import `nn` and below."""

from .codebook import Codebook, Share
from .rvq import Quantized, ResidualVectorQuantizer
from .usage import CodeUsage, code_usage

__all__ = ["CodeUsage", "Codebook", "Quantized", "ResidualVectorQuantizer", "Share", "code_usage"]
