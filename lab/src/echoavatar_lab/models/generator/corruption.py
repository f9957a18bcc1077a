"""Token corruption, uniform and hierarchical, as in the paper's appendix (Corruption-based Quality Ordering).

Used on the context motion tokens in training (Hierarchical Token Corruption against conditional collapse) and to grade
motion quality. Draws come from the generator alone. The body parts are corrupted independently of each other: the paper
defines one RVQ token grid of T x Q and does not say how three parts share it.
"""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


def corrupt_uniformly(
    codes: Int[Tensor, "b n p q"], rate: float | Float[Tensor, " b"], *, codebook: int, generator: torch.Generator
) -> Int[Tensor, "b n p q"]:
    """Replace each code with probability `rate` (one, or one per row) by one drawn from 0..`codebook` - 1."""
    rates = torch.as_tensor(rate).expand(len(codes))
    chosen = torch.rand(codes.shape, generator=generator) < rates[:, None, None, None]
    return _replace(codes, chosen, codebook, generator)


def corrupt_hierarchically(
    codes: Int[Tensor, "b n p q"], rate: float | Float[Tensor, " b"], *, codebook: int, generator: torch.Generator
) -> Int[Tensor, "b n p q"]:
    """Replace, in floor(rate x n) time steps of each row and part, all layers from a random depth on.

    The depth q* is uniform over 0..Q-1 for each chosen time step; layers q >= q* are drawn uniformly, coarser ones
    stay. `rate` is one number or one per row (b,).
    """
    rows, steps, parts, layers = codes.shape
    rates = torch.as_tensor(rate, dtype=torch.float64).expand(rows)
    count = (rates * steps + 1e-9).floor().long()  # |S| = floor(rho T), robust to 0.3 * 10 = 2.999...
    order = torch.rand(rows, steps, parts, generator=generator).argsort(dim=1).argsort(dim=1)
    selected = order < count[:, None, None]
    depth = torch.randint(layers, (rows, steps, parts, 1), generator=generator)
    deep = torch.arange(layers) >= depth
    return _replace(codes, selected[..., None] & deep, codebook, generator)


def _replace(
    codes: Int[Tensor, "b n p q"], chosen: Bool[Tensor, "b n p q"], codebook: int, generator: torch.Generator
) -> Int[Tensor, "b n p q"]:
    noise = torch.randint(codebook, codes.shape, generator=generator, dtype=codes.dtype)
    return torch.where(chosen, noise, codes)
