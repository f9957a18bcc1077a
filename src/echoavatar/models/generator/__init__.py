"""Audio codes to motion codes: the model, streaming, training. May import `tokens` and below."""

from .config import GeneratorConfig, qwen_half_billion
from .exemplar import Exemplar, draw_exemplar
from .initial import align_embeddings, init_from_qwen
from .model import Generator
from .orders import open_stream
from .reliance import nll_by_domain
from .windows import TokenClip, WindowSampler, leveled_of, patience_of

__all__ = [
    "Exemplar",
    "Generator",
    "GeneratorConfig",
    "TokenClip",
    "WindowSampler",
    "align_embeddings",
    "draw_exemplar",
    "init_from_qwen",
    "leveled_of",
    "nll_by_domain",
    "open_stream",
    "patience_of",
    "qwen_half_billion",
]
