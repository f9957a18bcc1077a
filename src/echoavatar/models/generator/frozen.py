"""Weights of a generator in the layout of the compiled loop, made of the arrays of a checkpoint, one matrix at a time.

Norm scales are folded into the products that follow them, q, k and v are one product, gate and up are one product, the
scores' 1 / sqrt(d) is folded into q, and the channels of each q and k head lie in pairs. In int8 the weights
of a product are rounded once more after the folding, with one scale for each of its rows.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernel_math import F, Matrices
from echoavatar.stored import Rounded, Stored, round_to_int8

from .compiled import Weights
from .config import AUDIO_FRAMES_PER_TOKEN, GeneratorConfig
from .manner import HANDS, HEIGHTS, KNOTS, MANNER


class Frozen:
    """The arrays of a generator, read as the products of its transformers."""

    def __init__(self, arrays: Mapping[str, Stored], *, rounds: bool) -> None:
        """With `rounds` products have int8 weights, else float32."""
        self._arrays, self._rounds = arrays, rounds

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def floats(self, name: str) -> Float[np.ndarray, "..."]:
        """An array in float32."""
        stored = self._arrays[name]
        return stored.floats() if isinstance(stored, Rounded) else stored.astype(F, copy=False)

    def plain(self, name: str, which: slice = slice(None)) -> Matrices:
        """A map as it is stored, or some of its rows."""
        stored = self._arrays[name]
        if isinstance(stored, Rounded):
            return stacked([(Rounded(stored.integers[which], stored.scale[which]), None)])
        return stacked([(stored[which].astype(F), None)])

    def body(self, prefix: str, config: GeneratorConfig, heads: Iterable[np.ndarray]) -> Weights:
        """A transformer, and `heads`: matrices of one size that read its normed hidden state."""
        root = config.width**0.5
        layers = [f"{prefix}.layers.{layer}" for layer in range(config.layers)]
        after = self.floats(f"{prefix}.norm.weight") * root
        return Weights(
            Matrices(np.zeros((1, 1, 1), np.int8 if self._rounds else F), np.ones((1, 1), F), np.zeros((1, 1), F)),
            stacked([self._qkv(layer, config, root) for layer in layers]),
            stacked([(self._map(f"{layer}.self_attn.o_proj.weight"), None) for layer in layers]),
            stacked([(self._gate_up(layer, root), None) for layer in layers]),
            stacked([(self._map(f"{layer}.mlp.down_proj.weight"), None) for layer in layers]),
            stacked([(self._kept(head * after), None) for head in heads]),
            np.zeros(1, np.int64),
            np.float32(config.width * config.norm_eps),
        )

    def _map(self, name: str) -> Stored:
        stored = self._arrays[name]
        return stored if isinstance(stored, Rounded) and self._rounds else self._kept(self.floats(name))

    def _qkv(self, layer: str, config: GeneratorConfig, root: float) -> tuple[Stored, Float[np.ndarray, " o"]]:
        scale, width = config.head_width**-0.5, config.head_width
        names = [f"{layer}.self_attn.{part}_proj" for part in "qkv"]
        q, k, v = (self.floats(f"{name}.weight") for name in names)
        q_bias, k_bias, v_bias = (self.floats(f"{name}.bias") for name in names)
        weight = np.concatenate([_paired(q * scale, width), _paired(k, width), v])
        bias = np.concatenate([_paired(q_bias * scale, width), _paired(k_bias, width), v_bias])
        return self._kept(weight * (self.floats(f"{layer}.input_layernorm.weight") * root)), bias

    def _gate_up(self, layer: str, root: float) -> Stored:
        weight = np.concatenate([self.floats(f"{layer}.mlp.{part}_proj.weight") for part in ("gate", "up")])
        return self._kept(weight * (self.floats(f"{layer}.post_attention_layernorm.weight") * root))

    def _kept(self, weight: Float[np.ndarray, "o i"]) -> Stored:
        return round_to_int8(weight) if self._rounds else weight


def shapes(config: GeneratorConfig) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the weights of a generator of the depth order."""
    layout, read = config.layout, config.read_width
    found: dict[str, tuple[int, ...]] = {"lm_head.weight": (layout.vocabulary, read)}
    found["depth.sound.weight"] = config.width, AUDIO_FRAMES_PER_TOKEN * config.width
    found["depth.condition.weight"] = read, config.width
    for prefix, body in (("model", config), ("depth.body", config.depth)):
        width, kv = body.width, body.kv_heads * body.head_width
        found |= {f"{prefix}.embed_tokens.weight": (layout.vocabulary, width), f"{prefix}.norm.weight": (width,)}
        for layer in range(body.layers):
            maps = {f"self_attn.{name}_proj": size for name, size in (("q", width), ("k", kv), ("v", kv))}
            sizes: dict[str, tuple[int, ...]] = {f"{name}.weight": (size, width) for name, size in maps.items()}
            sizes |= {f"{name}.bias": (size,) for name, size in maps.items()}
            sizes |= {"self_attn.o_proj.weight": (width, width), "mlp.down_proj.weight": (width, body.mlp)}
            sizes |= {f"mlp.{name}_proj.weight": (body.mlp, width) for name in ("gate", "up")}
            sizes |= {f"{name}_layernorm.weight": (width,) for name in ("input", "post_attention")}
            found |= {f"{prefix}.layers.{layer}.{name}": size for name, size in sizes.items()}
    if config.exemplar and config.control == "gate":
        found |= {"exemplar.hint_proj.weight": (config.width, config.width)}
    if config.manner:
        found["manner.proj.weight"] = config.width, len(MANNER + HANDS) * KNOTS
        found["manner.codes_proj.weight"] = layout.motion_codes, len(HEIGHTS) * KNOTS
    for name in {name.partition(".")[0] for name in found} & {"exemplar", "manner"}:
        found |= {f"{name}.gate_proj.weight": (1, read), f"{name}.gate_proj.bias": (1,)}
    return found


def rows_of(stored: Stored, which: Sequence[int] | np.ndarray | slice) -> Float[np.ndarray, "... i"]:
    """Some rows of a matrix in float32."""
    if isinstance(stored, Rounded):
        return np.asarray(stored.integers[which] * stored.scale[which])
    return np.asarray(stored[which], F)


def _paired(rows: np.ndarray, head_width: int) -> np.ndarray:
    """The outputs of each head from (all firsts, all seconds) to (first, second) pairs."""
    return rows.reshape(-1, 2, head_width // 2, *rows.shape[1:]).swapaxes(1, 2).reshape(rows.shape)


def stacked(maps: Sequence[tuple[Stored, np.ndarray | None]]) -> Matrices:
    """The same map of several layers in one array, with biases or without."""
    weight = np.stack([one.integers if isinstance(one, Rounded) else one for one, _ in maps])
    scale = np.stack([one.scale[:, 0] if isinstance(one, Rounded) else np.ones(len(one), F) for one, _ in maps])
    bias = np.stack([np.zeros(weight.shape[1], F) if bias is None else bias for _, bias in maps])
    return Matrices(weight, scale.astype(F), bias.astype(F))
