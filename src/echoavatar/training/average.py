"""Averaged weights (EMA): a slow copy of what learns, which is what a checkpoint shows."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor, nn

_RAMP = (
    10  # at step n no more than (1 + n) / (10 + n): a young average must not remember its random beginning
)


class Average:
    """The moving average of all parameters that learn, by `module.parameter`."""

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
        """One step towards the weights as they are after `step` steps."""
        share = 1 - min(self.decay, (1 + step) / (_RAMP + step))
        for key, value in self.values.items():
            value.lerp_(self._learned[key].detach().to(value.dtype), share)

    @contextmanager
    def shown(self) -> Iterator[None]:
        """While it is entered, the modules have the averaged weights."""
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
