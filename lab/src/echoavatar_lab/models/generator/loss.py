"""The training objective: cross-entropy of motion codes, weighted by RVQ depth (paper, Hierarchical Loss Scaling)."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.models.generator.exemplar import UPPER, Exemplar
from echoavatar.models.generator.model import Generator
from echoavatar.models.tokens import Sequences

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
    rows, segments, steps = nll.shape
    counted = (nll * batch.mask[:, None]).view(rows, -1, len(depth_weights), steps)
    by_layer = counted.sum((0, 1, 3)) / (batch.mask.sum() * (segments // len(depth_weights)))
    weighted = [weight * nats for weight, nats in zip(depth_weights, by_layer, strict=True)]
    return torch.stack(weighted).sum() / sum(depth_weights)


def to_device(batch: Sequences, device: str) -> Sequences:
    """Move every tensor."""
    ids, valid, predictors, targets, mask, asked = batch
    valid, asked = (part if part is None else part.to(device) for part in (valid, asked))
    return Sequences(ids.to(device), valid, predictors.to(device), targets.to(device), mask.to(device), asked)


def summary(
    nll: Float[Tensor, "b k n"], batch: Sequences, window: Window, exemplar: Exemplar | None = None
) -> dict[str, Tensor]:
    """Mean NLL per domain, and per RVQ layer; of the directive's layer where one holds and where none does.

    A mean of nothing is NaN: asking whether there is something would wait for the device.
    """
    counts = batch.mask[:, None].expand_as(nll)
    heard = window.domain if batch.asked is None else window.domain[:, batch.asked]
    domain = heard.to(nll.device)[:, None].expand_as(nll)
    means = {f"nll_{name}": _mean(nll, counts & (domain == index)) for index, name in enumerate(DOMAINS)}
    parts = window.motion.shape[2]
    layers = nll.view(len(nll), parts, -1, nll.shape[2]).transpose(1, 2)
    there = counts.reshape(len(nll), parts, -1, nll.shape[2]).transpose(1, 2)
    if exemplar is not None:
        holds = exemplar.at(batch.asked).holds
        for name, where in (("told", holds), ("untold", ~holds)):
            means[f"nll_upper_{name}"] = _mean(layers[:, 0, UPPER], where & batch.mask)
    return means | {f"nll_layer_{q}": _mean(layers[:, q], there[:, q]) for q in range(layers.shape[1])}


def _mean(nll: Float[Tensor, "*any"], where: Bool[Tensor, "*any"]) -> Float[Tensor, ""]:
    return (nll * where).sum() / where.sum()
