"""Causal attention in a sliding band, computed in blocks of queries, so that keys outside the band cost nothing."""

from contextlib import AbstractContextManager, nullcontext

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.attention import SDPBackend, sdpa_kernel

BLOCK = 256


def in_band(query: Int[Tensor, " t"], key: Int[Tensor, " s"], lookback: int | None) -> Bool[Tensor, "t s"]:
    """Which key positions a query position sees: itself and the `lookback` - 1 before it."""
    gap = query[:, None] - key[None, :]
    return gap >= 0 if lookback is None else (gap >= 0) & (gap < lookback)


def banded_attention(
    q: Float[Tensor, "b h t d"], k: Float[Tensor, "b h t d"], v: Float[Tensor, "b h t d"], lookback: int | None
) -> Float[Tensor, "b h t d"]:
    """Each position attends to itself and the `lookback` - 1 positions before it."""
    length = q.shape[2]
    if length <= BLOCK and (lookback is None or lookback >= length):
        with _kernel(q):
            return F.scaled_dot_product_attention(q, k, v, is_causal=True)
    at = torch.arange(length, device=q.device)
    parts = []
    for start in range(0, length, BLOCK):
        stop = min(start + BLOCK, length)
        first = 0 if lookback is None else max(0, start - lookback + 1)
        mask = in_band(at[start:stop], at[first:stop], lookback)
        with _kernel(q):
            block = F.scaled_dot_product_attention(
                q[:, :, start:stop], k[:, :, first:stop], v[:, :, first:stop], attn_mask=mask
            )
        parts.append(block)
    return torch.cat(parts, dim=2)


def masked_attention(
    q: Float[Tensor, "b h t d"],
    k: Float[Tensor, "b h t d"],
    v: Float[Tensor, "b h t d"],
    lookback: int | None,
    valid: Bool[Tensor, "b t"],
) -> Float[Tensor, "b h t d"]:
    """The same with invalid positions; an invalid position sees itself alone."""
    at = torch.arange(q.shape[2], device=q.device)
    mask = in_band(at, at, lookback) & valid[:, None, :] | torch.eye(len(at), dtype=torch.bool, device=q.device)
    return F.scaled_dot_product_attention(q, k, v, attn_mask=mask[:, None])


def _kernel(q: Tensor) -> AbstractContextManager[None]:
    """On a CPU the fused kernel's backward pass in bfloat16 takes seven times as long as the plain one."""
    is_trained = q.requires_grad and q.device.type == "cpu"
    return sdpa_kernel(SDPBackend.MATH) if is_trained else nullcontext()
