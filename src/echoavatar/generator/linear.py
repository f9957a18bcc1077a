"""Linear maps for decoding one position at a time: weights are read from memory once per token, so their size is the cost.

float32 is exact; bfloat16 halves the memory; int8 (one scale per output row, activations in bfloat16, products summed in
float32) quarters it. Quantising weights alone keeps every row independent of its neighbours in the batch, which
dynamically quantised activations do not.
"""

from abc import ABC, abstractmethod
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

Precision = Literal["float32", "bfloat16", "int8"]
MANY_ROWS = 16


class FrozenLinear(ABC):
    """x -> x W^T + bias for float32 x; the weights no longer train."""

    @abstractmethod
    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""


class FloatLinear(FrozenLinear):
    """Exact."""

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        self._weight = weight.detach().float().T.contiguous()
        self._bias = None if bias is None else bias.detach().float()

    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""
        return torch.mm(x, self._weight) if self._bias is None else torch.addmm(self._bias, x, self._weight)


class HalfLinear(FrozenLinear):
    """Weights and activations in bfloat16."""

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        self._weight = weight.detach().bfloat16().contiguous()
        self._bias = None if bias is None else bias.detach().bfloat16()

    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""
        return F.linear(x.bfloat16(), self._weight, self._bias).float()


class Int8Linear(FrozenLinear):
    """Weights in int8 with one scale per output row."""

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        weight = weight.detach().float()
        scale = (weight.abs().amax(dim=1) / 127).clamp(min=1e-12).bfloat16()
        self._scale = scale
        self._weight = (weight / scale.float()[:, None]).round().clamp(-127, 127).to(torch.int8).contiguous()
        self._dense = (self._weight.bfloat16() * scale[:, None]).contiguous()
        self._bias = None if bias is None else bias.detach().float()

    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows; many rows at once go through the same weights in bfloat16."""
        half = x.bfloat16()
        if len(x) > MANY_ROWS:
            y = F.linear(half, self._dense).float()
        else:
            y = torch._weight_int8pack_mm(half, self._weight, self._scale).float()
        return y if self._bias is None else y.add_(self._bias)


def frozen_linear(
    precision: Precision, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None = None
) -> FrozenLinear:
    """A linear map in that precision."""
    kinds = {"float32": FloatLinear, "bfloat16": HalfLinear, "int8": Int8Linear}
    return kinds[precision](weight, bias)
