"""Use of each codebook; a collapsed layer shows here first."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor


class CodeUsage(NamedTuple):
    """Per layer: share of the codes that occur, and perplexity (the equivalent number of even codes)."""

    fraction: Float[Tensor, " q"]
    perplexity: Float[Tensor, " q"]


def code_usage(codes: Int[Tensor, "*n q"], size: int) -> CodeUsage:
    """Statistics of codes 0..size-1; negative ones (layers not sent) do not count."""
    layers = codes.reshape(-1, codes.shape[-1]).unbind(-1)
    counts = torch.stack([torch.bincount(layer[layer >= 0], minlength=size) for layer in layers]).double()
    share = counts / counts.sum(-1, keepdim=True).clamp_min(1)
    entropy = -(share * share.clamp_min(1e-12).log()).sum(-1)
    return CodeUsage((counts > 0).double().mean(-1).float(), entropy.exp().float())
