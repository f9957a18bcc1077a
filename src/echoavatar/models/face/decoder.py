"""The face model's frames of one chunk: weights frozen for the compiled loop, and the memory it works in.

Computes what `FaceGpt` (ring form) and `FlowHead` compute (a test holds it to that), with the norms' weights folded
into the next projection.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar.nn import Mlp

from .attention import RingAttention
from .compiled import Affine, Steps, Weights, run_frames
from .flow import Schedule
from .gpt import GptState, RingBlock
from .model import FaceModel


class FrameDecoder:
    """Frozen weights of the ring form, in float32."""

    def __init__(self, model: FaceModel) -> None:
        gpt, head = model.gpt, model.head
        self._guidance = np.float32(model.config.guidance)
        blocks = [block for block in gpt.blocks if isinstance(block, RingBlock)]
        mlps = [mlp for mlp in head.mlps if isinstance(mlp, Mlp)]
        self._weights = Weights(
            embed=_stacked([_plain(gpt.embed)]),
            qkv=_stacked([_scaled_queries(_folded(block.norm1, block.attn.qkv), block.attn) for block in blocks]),
            project=_stacked([_plain(block.attn.proj) for block in blocks]),
            up=_stacked([_folded(block.norm2, block.mlp.fc1) for block in blocks]),
            down=_stacked([_plain(block.mlp.fc2) for block in blocks]),
            condition=_stacked([_chain(_folded(gpt.output_norm, gpt.output_proj), _plain(head.condition_proj))]),
            steer=_split(_plain(head.by_condition), len(mlps)),
            noisy=_stacked([_plain(head.noisy_proj)]),
            head_up=_stacked([_plain(mlp.fc1) for mlp in mlps]),
            head_down=_stacked([_plain(mlp.fc2) for mlp in mlps]),
            face=_stacked([_folded(head.output_norm, head.output_proj)]),
            distance=np.stack([np.tile(_floats(block.attn.bias), 2) for block in blocks]),
            heads=blocks[0].attn.heads,
        )

    def run(
        self,
        state: GptState,
        sound: Float[Tensor, "b t w"],
        active: Bool[Tensor, " b"],
        noise: Float[Tensor, "b t c"],
        schedule: Schedule,
    ) -> Float[np.ndarray, "b t c"]:
        """The next normalised frames of the active rows (zeros elsewhere); their keys and values go into `state.ring`.

        The rest of the state is left to `FaceGpt.commit`.
        """
        levels = np.array([(level, after) for _, level, after in schedule])
        shares = (levels[:, 0] - levels[:, 1]) / (levels[:, 0] + 1e-9)
        times = np.stack([time.detach().float().numpy() for time, _, _ in schedule])
        steps = Steps(times, shares.astype(np.float32), self._guidance)
        heard, drawn, last = _floats(sound), _floats(noise), _floats(state.motion[:, -1])
        ring, seen, chosen = state.ring.numpy(), state.seen.numpy(), np.flatnonzero(active.numpy())
        frames = np.zeros(noise.shape, np.float32)
        run_frames(self._weights, ring, seen, chosen, heard, drawn, last, steps, frames)
        return frames


def _floats(x: Tensor) -> Float[np.ndarray, "..."]:
    return np.ascontiguousarray(x.detach().float().numpy())


class _Map(NamedTuple):
    """x W + b."""

    weight: Float[np.ndarray, "i o"]
    bias: Float[np.ndarray, " o"]


def _plain(linear: nn.Module) -> _Map:
    assert isinstance(linear, nn.Linear)
    return _Map(linear.weight.detach().numpy().T, linear.bias.detach().numpy())


def _folded(norm: nn.Module, linear: nn.Module) -> _Map:
    """The projection of a plainly normalised x that equals linear(norm(x))."""
    assert isinstance(norm, nn.LayerNorm)
    weight, bias = _plain(linear)
    gain, shift = norm.weight.detach().numpy(), norm.bias.detach().numpy()
    return _Map(gain[:, None] * weight, shift @ weight + bias)


def _scaled_queries(qkv: _Map, attention: nn.Module) -> _Map:
    """The scores' 1 / sqrt(d) is folded into the queries."""
    assert isinstance(attention, RingAttention)
    scale = np.ones_like(qkv.bias)
    scale[: attention.width] = (attention.width // attention.heads) ** -0.5
    return _Map(qkv.weight * scale, qkv.bias * scale)


def _split(whole: _Map, parts: int) -> Affine:
    """One projection as several of equal width."""
    weights, biases = np.split(whole.weight, parts, axis=1), np.split(whole.bias, parts)
    return _stacked([_Map(weight, bias) for weight, bias in zip(weights, biases, strict=True)])


def _chain(first: _Map, second: _Map) -> _Map:
    return _Map(first.weight @ second.weight, first.bias @ second.weight + second.bias)


def _stacked(maps: Sequence[_Map]) -> Affine:
    weights, biases = np.stack([one.weight for one in maps]), np.stack([one.bias for one in maps])
    return Affine(np.ascontiguousarray(weights, np.float32), np.ascontiguousarray(biases, np.float32))
