"""Vector quantisation: codebooks, residual stacks of them, their usage. May import `nn` and below."""

from .codebook import Codebook
from .rvq import Quantized, ResidualVectorQuantizer
from .usage import CodeUsage, code_usage

__all__ = ["CodeUsage", "Codebook", "Quantized", "ResidualVectorQuantizer", "code_usage"]
