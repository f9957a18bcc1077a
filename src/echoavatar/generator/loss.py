"""The training objective: cross-entropy of motion codes, weighted by RVQ depth (paper, Hierarchical Loss Scaling)."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from ..tokens import PARTS, Sequences
from .model import Generator


def code_nll(generator: Generator, batch: Sequences) -> Float[Tensor, "b k n"]:
    """Negative log-likelihood in nats of every motion code under its segment's K logits."""
    hidden = generator(batch.ids, batch.valid)
    logits = generator.segment_logits(hidden, batch.predictors).float()
    nll = F.cross_entropy(logits.flatten(0, 2), batch.targets.transpose(0, 1).flatten(), reduction="none")
    return nll.view(logits.shape[:3]).transpose(0, 1)


def hierarchical_loss(
    nll: Float[Tensor, "b k n"], batch: Sequences, depth_weights: Sequence[float]
) -> Float[Tensor, ""]:
    """Mean over codes, each layer weighted by `depth_weights` (one per RVQ layer, the first is the coarsest)."""
    weights = torch.tensor(depth_weights, device=nll.device).repeat(PARTS)[None, :, None] * batch.mask[:, None]
    return (nll * weights).sum() / weights.sum()
