"""Muon in the number type that the processor multiplies fast, and whether that is bfloat16.

torch's Muon orthogonalises in bfloat16 always. A processor without instructions for it then takes up to forty times as
long. Everything else is torch's: arguments, state and result.
"""

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether products of bfloat16 matrices are fast on the device: on every GPU, and on processors from AVX-512 on."""
    return device.type != "cpu" or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


class Muon(torch.optim.Muon):
    """torch's Muon with AdamW's step size; orthogonalises in float32 where bfloat16 is slow."""

    def __init__(self, matrices: Iterable[nn.Parameter], *, rate: float, weight_decay: float) -> None:
        """One `rate` serves it and an AdamW beside it."""
        super().__init__(matrices, lr=rate, weight_decay=weight_decay, adjust_lr_fn="match_rms_adamw")

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """One step, as torch's."""
        matrices = [matrix for group in self.param_groups for matrix in group["params"]]
        if all(multiplies_bfloat16(matrix.device) for matrix in matrices):
            return super().step(closure)  # type: ignore[no-untyped-call]
        loss = None if closure is None else torch.enable_grad()(closure)()
        for group in self.param_groups:
            for matrix in group["params"]:
                if matrix.grad is not None:
                    self._descend(matrix, matrix.grad, group)
        return loss

    def _descend(self, matrix: Tensor, gradient: Tensor, group: dict[str, Any]) -> None:
        momentum, rate = group["momentum"], group["lr"]
        buffer = self.state[matrix].setdefault("momentum_buffer", torch.zeros_like(matrix))
        buffer.lerp_(gradient, 1 - momentum)
        update = gradient.lerp(buffer, momentum) if group["nesterov"] else buffer
        direction = orthogonalised(update, group["ns_coefficients"], group["ns_steps"], group["eps"])
        matrix.mul_(1 - rate * group["weight_decay"])
        matrix.add_(direction, alpha=-rate * 0.2 * max(matrix.shape) ** 0.5)


def orthogonalised(matrix: Tensor, coefficients: tuple[float, float, float], steps: int, eps: float) -> Tensor:
    """The nearest orthogonal matrix, nearly: a Newton-Schulz iteration of an odd polynomial of degree five.

    Singular values end between about 0.7 and 1.2, in the matrix's own number type.
    """
    a, b, c = coefficients
    is_tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if is_tall else matrix
    x = x / x.norm().clamp(min=eps)
    for _ in range(steps):
        gram = x @ x.T
        x = torch.addmm(x, torch.addmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x.T if is_tall else x
