"""Attention that sees itself and a fixed number of past frames (paper, Motion Tokenizer: causal mask, look-back p).

Rotary positions (rotate-half layout, base 10000) make the result depend on distances only. So a stream needs only
the last keys and values, and may count positions from the oldest of them. Pairs of channels rotate by phases that grow
with the position, computed in double precision: a float32 phase at position 1e7 would be off by half a radian.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from echoavatar.nn.state import StreamState
from echoavatar_lab.nn.stream import StreamingModule, write_rows

ROPE_BASE = 10_000.0


def rotary_phases(positions: Int[Tensor, "*b t"], *, width: int, base: float = ROPE_BASE) -> Float[Tensor, "*b t half"]:
    """Phase of pair i, position * base^(-2i / width), in radians within one rotation, double precision."""
    exponent = torch.arange(0, width, 2, dtype=torch.float64, device=positions.device) / width
    return (positions.double()[..., None] * base**-exponent) % (2 * math.pi)


def phase_table(phases: Float[Tensor, "*b t half"]) -> Float[Tensor, "2 *b t d"]:
    """Cosines and signed sines for `rotary`."""
    cos, sin = phases.cos(), phases.sin()
    return torch.stack([torch.cat([cos, cos], -1), torch.cat([-sin, sin], -1)])


def rotary_table(length: int, width: int) -> Float[Tensor, "2 t d"]:
    """The table of positions 0 to `length` - 1, double precision."""
    return phase_table(rotary_phases(torch.arange(length), width=width))


def rotary(x: Float[Tensor, "*b t d"], table: Float[Tensor, "2 *#b t d"]) -> Float[Tensor, "*b t d"]:
    """Rotate the pairs of channels (i, i + d / 2) by the phases of their position."""
    return torch.addcmul(x * table[0], x.roll(x.shape[-1] // 2, -1), table[1])


TABLE_LENGTH = 96  # positions whose phases and mask are kept ready; longer inputs compute them


@dataclass
class AttentionState(StreamState):
    """The last `lookback` keys and values (in this order on axis k), oldest first, and how many were really seen."""

    ring: Float[Tensor, "b h 2 p d"]
    seen: Int[Tensor, " b"]


def lookback_mask(queries: int, lookback: int, *, past: int = 0) -> Bool[Tensor, "t k"]:
    """True where query i sees key j: i - lookback <= j - past <= i. The first `past` keys precede the queries."""
    query = torch.arange(queries)[:, None] + past
    key = torch.arange(queries + past)[None, :]
    return (key <= query) & (key >= query - lookback)


class CausalAttention(StreamingModule[AttentionState]):
    """Multi-head attention over the present frame and `lookback` past ones."""

    table: Tensor
    mask: Tensor

    def __init__(self, *, width: int, heads: int, lookback: int) -> None:
        super().__init__()
        if width % (2 * heads):
            raise ValueError(f"width ({width}) must be a multiple of twice the heads ({heads})")
        self.heads = heads
        self.lookback = lookback
        self.qkv = nn.Linear(width, 3 * width, bias=False)
        self.proj = nn.Linear(width, width)
        mask = lookback_mask(TABLE_LENGTH, lookback, past=lookback)
        self.register_buffer("table", rotary_table(TABLE_LENGTH, width // heads).float(), persistent=False)
        self.register_buffer("mask", mask, persistent=False)

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """The whole clip at once; the answer of `step` from a fresh state."""
        q, k, v = self._project(x).unbind(2)
        return self._attend(q, k, v, self._window(x.shape[1])[:, self.lookback :])

    def init_state(self, rows: int) -> AttentionState:
        """Nothing seen yet."""
        weight = self.qkv.weight.detach()
        ring = weight.new_zeros(rows, self.heads, 2, self.lookback, weight.shape[1] // self.heads)
        return AttentionState(ring, weight.new_zeros(rows, dtype=torch.int64))

    def step(
        self, x: Float[Tensor, "b t c"], state: AttentionState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b t c"]:
        """The next `t` frames of each active row."""
        t, past = x.shape[1], self.lookback
        qkv = self._project(x)
        ring = torch.cat([state.ring, qkv[:, :, 1:].to(state.ring.dtype)], 3)
        age = torch.arange(past, past - ring.shape[3], -1, device=x.device)  # frames before the first query
        visible = self._window(t) & (age <= state.seen[:, None])[:, None, None]
        y = self._attend(qkv[:, :, 0], ring[:, :, 0].to(qkv.dtype), ring[:, :, 1].to(qkv.dtype), visible)
        write_rows(state.ring, ring[:, :, :, t:], active)
        write_rows(state.seen, (state.seen + t).clamp(max=past), active)
        return y

    def _project(self, x: Tensor) -> Tensor:
        """Queries, keys and values (b h 3 t d)."""
        b, t, _ = x.shape
        projected: Tensor = self.qkv(x)
        return projected.view(b, t, 3, self.heads, -1).permute(0, 3, 2, 1, 4)

    def _window(self, t: int) -> Tensor:
        if t <= TABLE_LENGTH:
            return self.mask[:t, : t + self.lookback]
        return lookback_mask(t, self.lookback, past=self.lookback).to(self.mask.device)

    def _attend(self, q: Tensor, k: Tensor, v: Tensor, mask: Tensor) -> Tensor:
        length = k.shape[2]
        table = self.table[:, :length] if length <= TABLE_LENGTH else rotary_table(length, k.shape[3])
        table = table.to(q)
        q, k = rotary(q, table[:, -q.shape[2] :]), rotary(k, table)
        y = F.scaled_dot_product_attention(q, k, v, attn_mask=mask)
        result: Tensor = self.proj(y.transpose(1, 2).flatten(2))
        return result
