"""Linear maps of a frozen generator. The weights are read once per drawn code, so their size is the cost.

float32 is exact; bfloat16 halves the memory (and is slow on processors without bfloat16 instructions); int8 (one
scale per output row) quarters what the compiled loop reads. Only weights are quantised, which keeps every row
independent of its neighbours in the batch, as dynamically quantised activations would not.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from echoavatar.models.generator.config import Precision
from echoavatar.stored import Stored, round_to_int8
from echoavatar_lab.models.generator.model import DecoderLayer


class FloatLinear:
    """x -> x W^T + bias, exact; the weights no longer train."""

    dtype = torch.float32

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        self._weight = weight.detach().float().T.contiguous()
        self._bias = None if bias is None else bias.detach().float()

    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""
        return torch.mm(x, self._weight) if self._bias is None else torch.addmm(self._bias, x, self._weight)

    def stored(self) -> tuple[Stored, Float[np.ndarray, " o"] | None]:
        """What the compiled loop reads: weights, rounded or not, and the bias."""
        return self._weight.T.numpy(), None if self._bias is None else self._bias.numpy()


class HalfLinear:
    """The same with weights and activations in bfloat16."""

    dtype = torch.bfloat16

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        self._weight = weight.detach().bfloat16().contiguous()
        self._bias = None if bias is None else bias.detach().bfloat16()

    def __call__(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Map rows."""
        return F.linear(x, self._weight, self._bias)


class Int8Linear(FloatLinear):
    """Weights rounded to int8 with one scale per output row; rows are mapped by the same weights in float32."""

    def __init__(self, weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"] | None) -> None:
        self._rounded = round_to_int8(weight.detach().float().cpu().numpy())
        super().__init__(torch.from_numpy(self._rounded.floats()).to(weight.device), bias)

    def stored(self) -> tuple[Stored, Float[np.ndarray, " o"] | None]:
        """Integers with their scales, and the bias."""
        return self._rounded, super().stored()[1]


FrozenLinear = FloatLinear | HalfLinear


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


class FrozenLayer:
    """Four fused products of a layer; the scores' 1 / sqrt(d) is folded into the q projection."""

    def __init__(self, layer: DecoderLayer, head_width: int, precision: Precision) -> None:
        attention, mlp = layer.self_attn, layer.mlp
        scale = head_width**-0.5
        q = _pair(attention.q_proj.weight * scale, attention.q_proj.bias * scale, head_width)
        k = _pair(attention.k_proj.weight, attention.k_proj.bias, head_width)
        weight = torch.cat([q[0], k[0], attention.v_proj.weight])
        bias = torch.cat([q[1], k[1], attention.v_proj.bias])
        root = weight.shape[1] ** 0.5
        before = layer.input_layernorm.weight * root
        between = layer.post_attention_layernorm.weight * root
        gate_up = torch.cat([mlp.gate_proj.weight, mlp.up_proj.weight])
        self.qkv: FrozenLinear = frozen_linear(precision, weight * before, bias)
        self.out: FrozenLinear = frozen_linear(precision, attention.o_proj.weight)
        self.gate_up: FrozenLinear = frozen_linear(precision, gate_up * between)
        self.down: FrozenLinear = frozen_linear(precision, mlp.down_proj.weight)
        self.dtype = self.qkv.dtype


def _pair(
    weight: Float[Tensor, "o i"], bias: Float[Tensor, " o"], head_width: int
) -> tuple[Float[Tensor, "o i"], Float[Tensor, " o"]]:
    """Reorder the outputs of each head from (all firsts, all seconds) to (first, second) pairs."""
    order = torch.arange(weight.shape[0], device=weight.device)
    order = order.view(-1, 2, head_width // 2).transpose(1, 2).flatten()
    return weight[order], bias[order]
