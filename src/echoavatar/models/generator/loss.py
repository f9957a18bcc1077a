"""The training objective: cross-entropy of motion codes, weighted by RVQ depth (paper, Hierarchical Loss Scaling)."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from ..tokens import Sequences
from .exemplar import UPPER, Exemplar
from .model import Generator
from .windows import DOMAINS, Window


def code_nll(
    generator: Generator,
    batch: Sequences,
    hidden: Float[Tensor, "b t c"] | None = None,
    exemplar: Exemplar | None = None,
) -> Float[Tensor, "b k n"]:
    """Negative log-likelihood in nats of every motion code under its segment's K logits.

    `hidden` are the generator's hidden states, where they are known already; `exemplar` is the directive.
    """
    if hidden is None:
        hidden = generator.read(batch, exemplar)
    logits = generator.code_logits(batch, hidden, exemplar).float()
    nll = F.cross_entropy(logits.flatten(0, 2), batch.targets.transpose(0, 1).flatten(), reduction="none")
    return nll.view(logits.shape[:3]).transpose(0, 1)


def hierarchical_loss(
    nll: Float[Tensor, "b k n"], batch: Sequences, depth_weights: Sequence[float]
) -> Float[Tensor, ""]:
    """Mean over codes, each layer weighted by `depth_weights` (one per RVQ layer, the first is the coarsest)."""
    weights = (
        torch.tensor(depth_weights, device=nll.device).repeat(nll.shape[1] // len(depth_weights))[:, None]
        * batch.mask[:, None]
    )
    return (nll * weights).sum() / weights.sum()


def to_device(batch: Sequences, device: str) -> Sequences:
    """Move every tensor."""
    ids, valid, predictors, targets, mask, asked = batch
    valid, asked = (part if part is None else part.to(device) for part in (valid, asked))
    return Sequences(ids.to(device), valid, predictors.to(device), targets.to(device), mask.to(device), asked)


def summary(
    nll: Float[Tensor, "b k n"], batch: Sequences, window: Window, exemplar: Exemplar | None = None
) -> dict[str, float]:
    """Mean NLL per domain, and per RVQ layer; of the directive's layer where one holds and where none does."""
    counts = batch.mask[:, None].expand_as(nll)
    heard = window.domain if batch.asked is None else window.domain[:, batch.asked]
    domain = heard.to(nll.device)[:, None].expand_as(nll)
    means = {
        f"nll_{name}": nll[counts & (domain == index)].mean().item()
        for index, name in enumerate(DOMAINS)
        if bool((counts & (domain == index)).any())
    }
    parts = window.motion.shape[2]
    layers = nll.view(len(nll), parts, -1, nll.shape[2]).transpose(1, 2)
    there = counts.reshape(len(nll), parts, -1, nll.shape[2]).transpose(1, 2)
    if exemplar is not None:
        holds = exemplar.at(batch.asked).holds
        for name, where in (("told", holds), ("untold", ~holds)):
            chosen = layers[:, 0, UPPER][where & batch.mask]
            means |= {f"nll_upper_{name}": chosen.mean().item()} if len(chosen) else {}
    return means | {f"nll_layer_{q}": layers[:, q][there[:, q]].mean().item() for q in range(layers.shape[1])}
