"""The generator's body rearranged for decoding: fused projections, folded norms, keys and values in preallocated rings.

Computes what `Generator.forward` computes (a test holds it to that), with few operations per token: norm scales are
folded into the next projection, q, k and v are one product, gate and up are one product, and the rotary turn is one
complex product, for which the channels of each q and k head are reordered into pairs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor

from ..nn.stream import StreamState
from .exemplar import Steer, member_rows, segment_of
from .linear import FrozenLinear, Precision, frozen_linear
from .model import DecoderLayer, Generator
from .rotary import rotary_angles


@dataclass
class KeyValueRing(StreamState):
    """Keys (already turned) and values of one layer; the last slot takes the writes of rows that must not change."""

    keys: Float[Tensor, "b h s d"]
    values: Float[Tensor, "b h s d"]


class Places(NamedTuple):
    """Where the positions of one step live: turned how, written where, seeing what. h are key and value heads."""

    turns: Complex[Tensor, "b t 1 half"]
    writes: Int[Tensor, "b h t"]  # rows of the flattened ring
    bias: Float[Tensor, "b 1 1 t s"]  # 0 where a slot is seen, -inf where not

    def part(self, start: int, stop: int) -> "Places":
        """The positions from `start` to `stop` of the step."""
        return Places(
            self.turns[:, start:stop], self.writes[:, :, start:stop], self.bias[:, :, :, start:stop]
        )


class Decoder:
    """Frozen weights of a generator, on its device."""

    def __init__(self, generator: Generator, precision: Precision) -> None:
        config = self.config = generator.config
        width = config.width
        self._embedding = generator.model.embed_tokens.weight.detach().float()
        self._layers = [
            _FrozenLayer(layer, config.head_width, precision)
            for layer in generator.model.layers
            if isinstance(layer, DecoderLayer)
        ]
        scale = generator.model.norm.weight.detach().float() * width**0.5
        self._heads = [
            frozen_linear(precision, segment * scale) for segment in generator.segment_head().detach()
        ]
        self._control = generator.exemplar
        if self._control is not None:
            self._gate = (
                (self._control.gate_proj.weight * scale).detach().float(),
                self._control.gate_proj.bias,
            )
        self._directed = segment_of(config.layout)
        self._members = member_rows(self._embedding, config.layout)
        self._root_eps = torch.full((1, 1), (width * config.norm_eps) ** 0.5, device=self.device)

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self._embedding.device

    def rings(self, rows: int, slots: int) -> list[KeyValueRing]:
        """Empty rings of `slots` positions and the spare slot."""
        config = self.config
        shape = (rows, config.kv_heads, slots + 1, config.head_width)
        return [
            KeyValueRing(torch.zeros(shape, device=self.device), torch.zeros(shape, device=self.device))
            for _ in range(config.layers)
        ]

    def places(
        self,
        positions: Int[Tensor, "b t"],
        slots: Int[Tensor, "b t"],
        seen: Bool[Tensor, "b t s"],
        active: Bool[Tensor, " b"],
    ) -> Places:
        """Turns, writes and biases of a step; rows that are not active write to the spare slot."""
        config, rows, spare = self.config, positions.shape[0], seen.shape[2] - 1
        angles = rotary_angles(positions, width=config.head_width, theta=config.rope_theta)
        turns = torch.polar(torch.ones_like(angles), angles).to(torch.complex64)
        ring = torch.arange(rows * config.kv_heads, device=positions.device).view(rows, config.kv_heads, 1)
        slots = torch.where(active[:, None], slots, spare)
        bias = torch.zeros(seen.shape, device=positions.device).masked_fill_(~seen, -torch.inf)
        return Places(turns[:, :, None], ring * (spare + 1) + slots[:, None], bias[:, None, None])

    def steer(self, exemplar: Float[Tensor, "b K"] | None, bias: Float[Tensor, "b K"] | None) -> Steer | None:
        """What these weights make of a set and of a bias on its logits; without exemplar control the set is ignored."""
        if self._control is None or exemplar is None:
            if bias is None:
                return None
            return Steer(bias.new_zeros(len(bias), self.config.width), torch.zeros_like(bias), bias)
        hint = self._control.hint(exemplar, self._members)
        return Steer(hint, exemplar, torch.zeros_like(exemplar) if bias is None else bias)

    def run(
        self,
        ids: Int[Tensor, "b t"],
        places: Places,
        rings: Sequence[KeyValueRing],
        hint: Float[Tensor, "b c"] | None = None,
        hinted: int = 1,
    ) -> Float[Tensor, "b c"]:
        """Read ids, write their keys and values, return the normed hidden state of the last position.

        `hint` is added to the embeddings of the last `hinted` ids.
        """
        rows, length = ids.shape
        x = self._embedding[ids.flatten()]
        if hint is not None:
            x.view(rows, length, -1)[:, -hinted:] += hint[:, None]
        turns, writes, bias = places.turns, places.writes.flatten(), places.bias
        attend = self._attend_one if length == 1 else self._attend_many
        for layer, ring in zip(self._layers, rings, strict=True):
            qkv = layer.qkv(self._norm(x, layer.dtype)).float()
            x = x + layer.out(attend(qkv, turns, writes, bias, ring).to(layer.dtype))
            gate, up = layer.gate_up(self._norm(x, layer.dtype)).chunk(2, dim=1)
            x = x + layer.down((F.silu(gate) * up).to(layer.dtype))
        last = x if length == 1 else x.view(rows, length, -1)[:, -1]
        return self._norm(last, self._heads[0].dtype)

    def logits(
        self, hidden: Float[Tensor, "b c"], segment: int, steer: Steer | None = None
    ) -> Float[Tensor, "b K"]:
        """The K logits of one segment, under a directive where one is given."""
        logits = self._heads[segment](hidden).float()
        if steer is None or segment != self._directed:
            return logits
        if self._control is not None:
            logits = logits + F.linear(hidden.float(), *self._gate) * steer.members
        return logits + steer.bias

    def _norm(self, x: Float[Tensor, "n c"], dtype: torch.dtype) -> Float[Tensor, "n c"]:
        """Bring to unit length, x / sqrt(|x|^2 + c eps); the missing sqrt(c) is folded into the weights."""
        length = torch.linalg.vector_norm(x, dim=1, keepdim=True)
        return (x / torch.hypot(length, self._root_eps)).to(dtype)

    def _attend_one(
        self,
        qkv: Float[Tensor, "b qkv"],
        turns: Complex[Tensor, "b 1 1 half"],
        writes: Int[Tensor, " w"],
        bias: Float[Tensor, "b 1 1 1 s"],
        ring: KeyValueRing,
    ) -> Float[Tensor, "b c"]:
        """One position per row: no axes to reorder."""
        heads, kv, width = self.config.heads, self.config.kv_heads, self.config.head_width
        slots = ring.keys.shape[2]
        pairs = torch.view_as_complex(qkv.view(-1, heads + 2 * kv, width // 2, 2))
        turned = torch.view_as_real(pairs[:, : heads + kv] * turns[:, 0])
        ring.keys.view(-1, width).index_copy_(0, writes, turned[:, heads:].reshape(-1, width))
        ring.values.view(-1, width).index_copy_(0, writes, qkv[:, (heads + kv) * width :].reshape(-1, width))
        q = turned[:, :heads].reshape(-1, heads // kv, width)
        scores = torch.bmm(q, ring.keys.view(-1, slots, width).transpose(1, 2))
        scores.view(-1, heads, slots).add_(bias[:, 0, 0])
        y = torch.bmm(torch.softmax(scores, dim=-1), ring.values.view(-1, slots, width))
        return y.view(-1, heads * width)

    def _attend_many(
        self,
        qkv: Float[Tensor, "n qkv"],
        turns: Complex[Tensor, "b t 1 half"],
        writes: Int[Tensor, " w"],
        bias: Float[Tensor, "b 1 1 t s"],
        ring: KeyValueRing,
    ) -> Float[Tensor, "n c"]:
        heads, kv, width = self.config.heads, self.config.kv_heads, self.config.head_width
        (rows, length), group, slots = turns.shape[:2], heads // kv, ring.keys.shape[2]
        split = qkv.view(rows, length, heads + 2 * kv, width)
        pairs = torch.view_as_complex(split.view(rows, length, -1, width // 2, 2))
        turned = torch.view_as_real(pairs[:, :, : heads + kv] * turns).flatten(3)
        keys, values = ring.keys.view(-1, width), ring.values.view(-1, width)
        keys.index_copy_(0, writes, turned[:, :, heads:].transpose(1, 2).reshape(-1, width))
        values.index_copy_(0, writes, split[:, :, heads + kv :].transpose(1, 2).reshape(-1, width))
        q = turned[:, :, :heads].reshape(rows, length, kv, group, width).permute(0, 2, 3, 1, 4)
        q = q.reshape(rows * kv, group * length, width)
        scores = torch.bmm(q, keys.view(rows * kv, slots, width).transpose(1, 2))
        weights = torch.softmax(scores.view(rows, kv, group, length, slots).add_(bias), dim=-1)
        y = torch.bmm(weights.view(rows * kv, group * length, slots), values.view(rows * kv, slots, width))
        return y.view(rows, heads, length, width).transpose(1, 2).reshape(rows * length, heads * width)


class _FrozenLayer:
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
