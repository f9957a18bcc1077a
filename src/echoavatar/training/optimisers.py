"""The optimiser that training tasks share."""

from collections.abc import Iterable

import torch
from torch import nn

from .config import TrainingConfig


def adamw(
    modules: Iterable[nn.Module],
    config: TrainingConfig,
    *,
    but: Iterable[nn.Parameter] = (),
    decays_vectors: bool = False,
) -> torch.optim.AdamW:
    """AdamW over the trained parameters except `but`; norms and biases have no decay unless `decays_vectors`."""
    left_out = {id(parameter) for parameter in but}
    learned = [
        parameter
        for module in modules
        for parameter in module.parameters()
        if parameter.requires_grad and id(parameter) not in left_out
    ]
    decayed = [p for p in learned if p.dim() > 1 or decays_vectors]
    others = [p for p in learned if not (p.dim() > 1 or decays_vectors)]
    groups = [
        {"params": params, "weight_decay": decay}
        for params, decay in ((decayed, config.weight_decay), (others, 0.0))
        if params
    ]
    return torch.optim.AdamW(groups, lr=config.learning_rate, betas=config.betas, fused=True)
