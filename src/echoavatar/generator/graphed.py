"""A step of the prefix order in fixed shapes, to be captured as a CUDA graph: prompt in, codes out.

Computes what `PrefixStream` computes (a test holds it to that). The prompt has room for an example of fixed length in
front; what is not used there does not count. Keys and values lie in one table per layer that every step writes anew.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ..nn.graphs import Graphed
from .model import DecoderLayer, Generator
from .rotary import rotary_angles, rotate
from .sampling import Sampler, gumbel_noise


class _Layer(NamedTuple):
    """A layer's weights, fused."""

    before: Tensor
    qkv: Tensor
    qkv_bias: Tensor
    out: Tensor
    between: Tensor
    gate_up: Tensor
    down: Tensor


class GraphedPrefix:
    """Codes of a step from its prompt; one captured graph for `rows` sessions and prompts of `length` ids."""

    def __init__(
        self, generator: Generator, *, rows: int = 1, length: int, dtype: torch.dtype = torch.bfloat16
    ) -> None:
        config = self.config = generator.config
        self._device = generator.lm_head.weight.device
        self._embedding = generator.model.embed_tokens.weight.detach().to(dtype)
        self._heads = generator.segment_head().detach().to(dtype)
        self._norm = generator.model.norm.weight.detach().to(dtype)
        layers = [layer for layer in generator.model.layers if isinstance(layer, DecoderLayer)]
        self._layers = [_fused(layer, dtype) for layer in layers]
        self.count = config.step * config.layout.segments
        shape = (rows, config.kv_heads, length + self.count, config.head_width)
        self._tables = [
            (
                torch.zeros(shape, device=self._device, dtype=dtype),
                torch.zeros(shape, device=self._device, dtype=dtype),
            )
            for _ in layers
        ]
        self._starts = [config.layout.segment_start(segment) for segment in range(config.layout.segments)]
        wide = len(config.directed) * config.layout.motion_codes
        with torch.no_grad():
            self._graph = Graphed(
                self._run,
                torch.zeros(rows, length, dtype=torch.int64, device=self._device),
                torch.ones(rows, length, dtype=torch.bool, device=self._device),
                torch.zeros(rows, dtype=torch.int64, device=self._device),
                torch.zeros(rows, dtype=torch.int64, device=self._device),
                torch.ones(rows, device=self._device),
                torch.zeros(rows, wide, device=self._device),
            )

    @torch.no_grad()
    def step(
        self,
        prompt: Int[Tensor, "b t"],
        valid: Bool[Tensor, "b t"],
        *,
        seeds: Int[Tensor, " b"],
        heard: Int[Tensor, " b"],
        temperature: Float[Tensor, " b"],
        bias: Float[Tensor, "b K"],
    ) -> Int[Tensor, "b n"]:
        """Codes in the order of the motion grammar; `heard` steps came before, which numbers the noise."""
        return self._graph(prompt, valid, seeds, heard, temperature, bias)

    def _run(
        self, prompt: Tensor, valid: Tensor, seeds: Tensor, heard: Tensor, temperature: Tensor, bias: Tensor
    ) -> Tensor:
        config, length = self.config, prompt.shape[1]
        noise = gumbel_noise(seeds, heard * self.count, count=self.count, codes=config.layout.motion_codes)
        top_p = torch.full_like(temperature, config.top_p)
        sampler = Sampler(
            noise, temperature, top_p, layers=config.layout.motion_layers, cooling=config.cooling
        )
        positions = (valid.long().cumsum(1) - 1).clamp(min=0)
        at = torch.arange(length, device=prompt.device)
        eye = torch.eye(length, dtype=torch.bool, device=prompt.device)
        seen = (at[:, None] >= at) & valid[:, None] | eye
        x = self._forward(self._embedding[prompt], positions, 0, seen[:, None])
        last, codes = positions[:, -1:], list[Tensor]()
        later = torch.ones(len(valid), self.count, dtype=torch.bool, device=prompt.device)
        everything = torch.cat([valid, later], 1)[:, None, None]
        for index in range(self.count):
            segment = index % config.layout.segments
            hidden = F.rms_norm(x[:, -1], self._norm.shape, self._norm, config.norm_eps)
            logits = (hidden @ self._heads[segment].T).float()
            if segment in config.directed:
                place = config.directed.index(segment) * logits.shape[1]
                logits = logits + bias[:, place : place + logits.shape[1]]
            codes.append(sampler.draw(logits, index))
            if index < self.count - 1:
                token = self._embedding[codes[-1][:, None] + self._starts[segment]]
                end = length + index + 1
                x = self._forward(token, last + index + 1, end - 1, everything[..., :end])
        return torch.stack(codes, 1)

    def _forward(self, x: Tensor, positions: Tensor, start: int, seen: Tensor) -> Tensor:
        """Through all layers; keys and values of these positions go into the tables from `start` on."""
        config, end = self.config, start + x.shape[1]
        angles = rotary_angles(positions, width=config.head_width, theta=config.rope_theta)
        heads, kv = config.heads, config.kv_heads
        for layer, (keys, values) in zip(self._layers, self._tables, strict=True):
            y = F.rms_norm(x, layer.before.shape, layer.before, config.norm_eps)
            qkv = F.linear(y, layer.qkv, layer.qkv_bias).unflatten(2, (heads + 2 * kv, -1)).transpose(1, 2)  # type: ignore[no-untyped-call]
            q, k, v = qkv.split((heads, kv, kv), 1)
            q = rotate(q, angles).to(x.dtype)
            keys[:, :, start:end], values[:, :, start:end] = rotate(k, angles).to(x.dtype), v
            mixed = F.scaled_dot_product_attention(
                q, keys[:, :, :end], values[:, :, :end], attn_mask=seen, enable_gqa=True
            )
            x = x + F.linear(mixed.transpose(1, 2).flatten(2), layer.out)
            y = F.rms_norm(x, layer.between.shape, layer.between, config.norm_eps)
            gate, up = F.linear(y, layer.gate_up).chunk(2, -1)
            x = x + F.linear(F.silu(gate) * up, layer.down)
        return x


def _fused(layer: DecoderLayer, dtype: torch.dtype) -> _Layer:
    attention, mlp = layer.self_attn, layer.mlp
    projections = (attention.q_proj, attention.k_proj, attention.v_proj)
    parts = (
        layer.input_layernorm.weight,
        torch.cat([own.weight for own in projections]),
        torch.cat([own.bias for own in projections]),
        attention.o_proj.weight,
        layer.post_attention_layernorm.weight,
        torch.cat([mlp.gate_proj.weight, mlp.up_proj.weight]),
        mlp.down_proj.weight,
    )
    return _Layer(*(part.detach().to(dtype) for part in parts))
