"""Vector quantisation: codebooks, residual stacks of them, their usage. May import `nn` and below."""

from .codebook import Codebook, Share
from .rvq import ResidualVectorQuantizer
from .usage import code_usage

__all__ = ["Codebook", "ResidualVectorQuantizer", "Share", "code_usage"]
