"""Muon: steps along the nearest orthogonal matrix of the momentum, all matrices of one shape in one product.

Arguments, state and result are those of torch's Muon, which takes one matrix at a time: a GPU then waits for the next
of a thousand short kernels. And torch's orthogonalises in bfloat16 always; a processor without instructions for it
takes up to forty times as long, so there we use float32.
"""

from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether products of bfloat16 matrices are fast on the device: on every GPU, and on processors from AVX-512 on."""
    return device.type != "cpu" or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


class Muon(torch.optim.Muon):
    """torch's Muon with AdamW's step size; faster, see the module."""

    def __init__(self, matrices: Iterable[nn.Parameter], *, rate: float, weight_decay: float) -> None:
        """One `rate` serves it and an AdamW beside it."""
        super().__init__(matrices, lr=rate, weight_decay=weight_decay, adjust_lr_fn="match_rms_adamw")

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """One step, as torch's."""
        loss = None if closure is None else torch.enable_grad()(closure)()
        for group in self.param_groups:
            alike: dict[torch.Size, list[Tensor]] = defaultdict(list)
            for matrix in group["params"]:
                if matrix.grad is not None:
                    alike[matrix.shape].append(matrix)
            for matrices in alike.values():
                self._descend(matrices, group)
        return loss

    def _descend(self, matrices: list[Tensor], group: dict[str, Any]) -> None:
        """One step of matrices of one shape."""
        momentum, rate = group["momentum"], group["lr"]
        gradients = [matrix.grad for matrix in matrices if matrix.grad is not None]
        buffers = [self.state[m].setdefault("momentum_buffer", torch.zeros_like(m)) for m in matrices]
        torch._foreach_lerp_(buffers, gradients, 1 - momentum)
        updates = torch._foreach_lerp(gradients, buffers, momentum) if group["nesterov"] else buffers
        stacked = torch.stack(list(updates))
        stacked = stacked.bfloat16() if multiplies_bfloat16(stacked.device) else stacked
        directions = orthogonalised(stacked, group["ns_coefficients"], group["ns_steps"], group["eps"])
        torch._foreach_mul_(matrices, 1 - rate * group["weight_decay"])
        scale = -rate * 0.2 * max(matrices[0].shape) ** 0.5
        torch._foreach_add_(matrices, list(directions.to(matrices[0].dtype).unbind()), alpha=scale)


def orthogonalised(matrices: Tensor, coefficients: tuple[float, float, float], steps: int, eps: float) -> Tensor:
    """Of each matrix (..., r, c) the nearest orthogonal one, nearly, by a Newton-Schulz polynomial of degree five.

    Singular values end between about 0.7 and 1.2, in the matrices' own number type.
    """
    a, b, c = coefficients
    is_tall = matrices.shape[-2] > matrices.shape[-1]
    x: Tensor = matrices.mT if is_tall else matrices
    x = x / x.norm(dim=(-2, -1), keepdim=True).clamp(min=eps)
    for _ in range(steps):
        gram = x @ x.mT
        x = a * x + (b * gram + c * gram @ gram) @ x
    return x.mT if is_tall else x
