"""The face model's frame loop in NumPy: eight frames, each a handful of tiny matrix products.

Computes what `FaceGpt` (ring form) and `FlowHead` compute (a test holds it to that). A frame is some three hundred
operations on a few hundred numbers; at that size what costs is calling them, and a NumPy call is several times cheaper
than a torch call. Norm weights are folded into the next projection.
"""

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor, nn

from ..nn import Mlp
from .attention import RingAttention
from .flow import HEAD_EPSILON, Schedule
from .gpt import BRANCHES, RingBlock, Run
from .model import FaceModel

Array = NDArray[np.floating]
SMALL = 2**18  # multiplications that NumPy's BLAS does in the calling thread


class FrameDecoder:
    """Frozen weights of the ring form; `run` generates the frames of one chunk."""

    def __init__(self, model: FaceModel) -> None:
        gpt, head = model.gpt, model.head
        self._guidance = model.config.guidance
        self._embed = _affine(gpt.embed)
        self._blocks = [_Block(block) for block in gpt.blocks if isinstance(block, RingBlock)]
        self._condition = _chain(_folded(gpt.output_norm, gpt.output_proj), _affine(head.condition_proj))
        self._steer = _affine(head.by_condition)
        self._noisy = _affine(head.noisy_proj)
        self._mlps = [_Mlp(mlp, None) for mlp in head.mlps if isinstance(mlp, Mlp)]
        self._face = _folded(head.output_norm, head.output_proj)

    def run(
        self,
        run: Run,
        last: Float[Tensor, "b c"],
        sound: Float[Tensor, "b t w"],
        noise: Float[Tensor, "b t c"],
        schedule: Schedule,
    ) -> Float[np.ndarray, "b t c"]:
        """The normalised frames after `last`; keys and values go into the caches of `run`."""
        heard = np.repeat(sound.detach().numpy(), BRANCHES, axis=0)
        heard[::BRANCHES] = 0
        caches = [cache.numpy() for (cache,) in run.caches]
        masks = [mask.numpy() for mask in run.masks]
        draws, face = noise.numpy(), last.detach().numpy()
        times = [time.detach().numpy() for time, _, _ in schedule]
        levels = [(level, following) for _, level, following in schedule]
        frames = np.empty_like(draws)
        for i in range(draws.shape[1]):
            x = np.repeat(self._embed(face), BRANCHES, axis=0)
            for block, cache, mask in zip(self._blocks, caches, masks, strict=True):
                x = block(x + heard[:, i], cache, mask[:, :, i], run.past + i)
            face = frames[:, i] = self._sample(self._condition(_normal(x)), draws[:, i], times, levels)
        run.at += draws.shape[1]
        return frames

    def _sample(
        self, condition: Array, noise: Array, times: Sequence[Array], levels: Sequence[tuple[float, float]]
    ) -> Array:
        """Euler steps from noise to a face; both guidance branches of a session lie side by side."""
        shape = (len(condition), len(self._mlps), 3, -1)
        steering = [self._steer(_silu(time + condition)).reshape(shape) for time in times]
        x = noise
        for steer, (level, following) in zip(steering, levels, strict=True):
            y = np.repeat(self._noisy(x), BRANCHES, axis=0)
            for k, mlp in enumerate(self._mlps):
                shift, scale, gate = steer[:, k, 0], steer[:, k, 1], steer[:, k, 2]
                y = y + gate * mlp(_normal(y, HEAD_EPSILON) * (1 + scale) + shift)
            faces = self._face(_normal(y))
            without, with_sound = faces[::BRANCHES], faces[1::BRANCHES]
            face = without + self._guidance * (with_sound - without)
            x = x + (face - x) * ((level - following) / (level + 1e-9))
        return x


class _Affine:
    """x @ weight + bias. Large products go to torch, whose threads the caller rules; NumPy's BLAS has its own."""

    def __init__(self, weight: Array, bias: Array) -> None:
        self.weight, self.bias = weight, bias
        self._weight, self._bias = torch.from_numpy(weight), torch.from_numpy(bias)

    def __call__(self, x: Array) -> Array:
        if len(x) * self.weight.size <= SMALL:
            return np.asarray(x @ self.weight + self.bias)
        return np.asarray(torch.addmm(self._bias, torch.from_numpy(x), self._weight).numpy())


class _Mlp:
    """Linear, GELU (erf), linear; behind a norm, whose weights are folded in, or not."""

    def __init__(self, mlp: Mlp, norm: nn.LayerNorm | None) -> None:
        self._first = _folded(norm, mlp.fc1) if norm else _affine(mlp.fc1)
        self._second = _affine(mlp.fc2)

    def __call__(self, x: Array) -> Array:
        return self._second(F.gelu(torch.from_numpy(self._first(x))).numpy())


class _Block:
    """Attention over the ring and MLP."""

    def __init__(self, block: RingBlock) -> None:
        attention = block.attn
        assert isinstance(attention, RingAttention)
        self._heads, self._lookback = attention.heads, attention.lookback
        qkv = _folded(block.norm1, attention.qkv)
        scale = np.ones_like(qkv.bias)
        scale[: attention.width] = (attention.width // attention.heads) ** -0.5
        self._qkv = _Affine(qkv.weight * scale, qkv.bias * scale)
        self._project = _affine(attention.proj)
        self._mlp = _Mlp(block.mlp, block.norm2)

    def __call__(self, x: Array, cache: Array, mask: Array, at: int) -> Array:
        """One position of every row: `cache` (r n 2c) gets its slot `at`; `mask` (r h k) is added to the scores."""
        rows, width = x.shape
        qkv = self._qkv(_normal(x))
        cache[:, at] = qkv[:, width:]
        seen = cache[:, at - self._lookback : at + 1].reshape(rows, self._lookback + 1, 2, self._heads, -1)
        query = qkv[:, :width].reshape(rows, self._heads, 1, -1)
        keys, values = seen[:, :, 0].transpose(0, 2, 3, 1), seen[:, :, 1].transpose(0, 2, 1, 3)
        scores = (query @ keys)[:, :, 0] + mask
        weights = np.exp(scores - scores.max(-1, keepdims=True))
        weights /= weights.sum(-1, keepdims=True)
        x = x + self._project((weights[:, :, None] @ values).reshape(rows, width))
        return x + self._mlp(_normal(x))


def _affine(linear: nn.Module) -> _Affine:
    assert isinstance(linear, nn.Linear)
    weight, bias = linear.weight.detach().numpy(), linear.bias.detach().numpy()
    return _Affine(np.ascontiguousarray(weight.T), bias.copy())


def _folded(norm: nn.Module, linear: nn.Module) -> _Affine:
    """The projection of `_normal(x)` that equals linear(norm(x))."""
    assert isinstance(norm, nn.LayerNorm)
    plain = _affine(linear)
    gain, shift = norm.weight.detach().numpy(), norm.bias.detach().numpy()
    return _Affine(gain[:, None] * plain.weight, shift @ plain.weight + plain.bias)


def _chain(first: _Affine, second: _Affine) -> _Affine:
    return _Affine(first.weight @ second.weight, first.bias @ second.weight + second.bias)


def _normal(x: Array, epsilon: float = 1e-5) -> Array:
    """Zero mean and unit variance over the last axis."""
    away = x - x.mean(-1, keepdims=True)
    power = np.einsum("...c,...c->...", away, away) / x.shape[-1]
    return np.asarray(away / np.sqrt(power + epsilon)[..., None])


def _silu(x: Array) -> Array:
    return np.asarray(x / (1 + np.exp(-x)))
