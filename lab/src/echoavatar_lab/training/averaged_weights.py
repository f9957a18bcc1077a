"""Averaged weights (EMA): a slowly moving copy of the trained parameters, which checkpoints contain."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor, nn

_RAMP = 10  # limits the decay at step n to (1 + n) / (10 + n), so that the random initial weights are soon forgotten


class AveragedWeights:
    """The moving average of all trained parameters, by `module.parameter`."""

    def __init__(self, modules: Mapping[str, nn.Module], decay: float) -> None:
        self.decay = decay
        self._learned = {
            f"{name}.{key}": parameter
            for name, module in modules.items()
            for key, parameter in module.named_parameters()
            if parameter.requires_grad
        }
        self.values: dict[str, Tensor] = {key: value.detach().clone() for key, value in self._learned.items()}

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Move the average towards the weights as they are after `step` steps."""
        share = 1 - min(self.decay, (1 + step) / (_RAMP + step))
        learned = [self._learned[key].detach().to(value.dtype) for key, value in self.values.items()]
        torch._foreach_lerp_(list(self.values.values()), learned, share)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Context in which the modules hold the averaged weights."""
        own = {key: value.detach().clone() for key, value in self._learned.items()}
        self._write(self.values)
        try:
            yield
        finally:
            self._write(own)

    @torch.no_grad()
    def _write(self, values: Mapping[str, Tensor]) -> None:
        for key, value in values.items():
            self._learned[key].copy_(value)
