"""Linear maps for decoding one position at a time: weights are read once per token, so their size is the cost.

float32 is exact; bfloat16 halves the memory (and is slow on processors without bfloat16 instructions); int8 (one
scale per output row, activations in bfloat16) quarters it. Quantising weights alone keeps every row independent of
its neighbours in the batch, which dynamically quantised activations do not.
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
    """x -> x W^T + bias for x of type `dtype`; the weights no longer train."""

    dtype: torch.dtype

    @abstractmethod
    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""


class FloatLinear(FrozenLinear):
    """Exact."""

    dtype = torch.float32

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        self._weight = weight.detach().float().T.contiguous()
        self._bias = None if bias is None else bias.detach().float()

    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""
        return torch.mm(x, self._weight) if self._bias is None else torch.addmm(self._bias, x, self._weight)


class HalfLinear(FrozenLinear):
    """Weights and activations in bfloat16."""

    dtype = torch.bfloat16

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        self._weight = weight.detach().bfloat16().contiguous()
        self._bias = None if bias is None else bias.detach().bfloat16()

    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""
        return F.linear(x, self._weight, self._bias)


class Int8Linear(FrozenLinear):
    """Weights in int8 with one scale per output row; many rows at once go through the same weights in float32."""

    dtype = torch.bfloat16

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        weight = weight.detach().float()
        scale = (weight.abs().amax(dim=1) / 127).clamp(min=1e-12).bfloat16()
        self._scale = scale
        self._weight = (weight / scale.float()[:, None]).round().clamp(-127, 127).to(torch.int8).contiguous()
        self._dense = FloatLinear(self._weight.float() * scale.float()[:, None], bias)
        self._bias = None if bias is None else bias.detach().float()

    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""
        if len(x) > MANY_ROWS:
            return self._dense(x.float())
        y = torch._weight_int8pack_mm(x, self._weight, self._scale)
        return y if self._bias is None else y + self._bias


def frozen_linear(
    precision: Precision, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None = None
) -> FrozenLinear:
    """A linear map in that precision."""
    match precision:
        case "float32":
            return FloatLinear(weight, bias)
        case "bfloat16":
            return HalfLinear(weight, bias)
        case "int8":
            return Int8Linear(weight, bias)
