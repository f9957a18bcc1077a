"""The face model's frames of one chunk: weights frozen for the compiled loop, and the memory it works in.

Computes what `FaceGpt` (ring form) and `FlowHead` compute (a test holds it to that), with the norms' weights folded
into the next projection. The compiled loop takes a chunk's eight frames, each some hundred small matrix products. Its
rows are sessions x guidance branches: 2 k is session k without sound, 2 k + 1 the same with sound.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar.nn import Mlp
from echoavatar.nn.kernel_math import ONE, ZERO, F, Matrices, attend, gelu, product, silu
from echoavatar.nn.kernels import kernel

from .flow import Schedule
from .gpt import GptState, RingAttention, RingBlock
from .model import FaceModel


class Affine(NamedTuple):
    """x W + b."""

    weight: np.ndarray  # (i, o)
    bias: np.ndarray  # (o)


class Weights(NamedTuple):
    """Frozen weights of the ring form; norm weights are folded into the products that follow them."""

    embed: Matrices
    qkv: Matrices
    project: Matrices
    up: Matrices
    down: Matrices
    condition: Matrices
    steer: Matrices  # one layer per block of the head
    noisy: Matrices
    head_up: Matrices
    head_down: Matrices
    face: Matrices
    distance: np.ndarray  # (l, h, 2 n) bias of the scores by distance, written twice in a row
    heads: int


class Steps(NamedTuple):
    """The Euler steps from noise to a face."""

    times: np.ndarray  # (n, w) what the time adds to the steering
    shares: np.ndarray  # (n,) how much of the way to the predicted face each step goes
    guidance: np.float32


@kernel(reorders=True)
def _normalise(x, epsilon, y):  # type: ignore[no-untyped-def]
    """Zero mean and unit variance of each row."""
    for row in range(x.shape[0]):
        mean, power = ZERO, ZERO
        for i in range(x.shape[1]):
            mean += x[row, i]
        mean /= F(x.shape[1])
        for i in range(x.shape[1]):
            away = x[row, i] - mean
            power += away * away
        scale = ONE / F(math.sqrt(power / F(x.shape[1]) + epsilon))
        for i in range(x.shape[1]):
            y[row, i] = (x[row, i] - mean) * scale


@kernel(reorders=True)
def _gelu(x):  # type: ignore[no-untyped-def]
    for row in range(x.shape[0]):
        for i in range(x.shape[1]):
            x[row, i] = gelu(x[row, i])


@kernel(reorders=True)
def _repeat(x, y):  # type: ignore[no-untyped-def]
    """Each session's row for both of its branches."""
    for row in range(y.shape[0]):
        for i in range(y.shape[1]):
            y[row, i] = x[row // 2, i]


@kernel(reorders=True)
def _look_back(weights, layer, ring, seen, chosen, i, qkv, scores, y):  # type: ignore[no-untyped-def]
    """Write each row's key and value into its slot of the ring, and what its heads see into y."""
    width, slots = ring.shape[4], ring.shape[5]
    each = width // weights.heads
    bias = np.empty(slots, F)
    for row in range(y.shape[0]):
        session = chosen[row // 2]
        now = seen[session] + i
        slot = now % slots
        keys, values = ring[session, layer, row % 2, 0], ring[session, layer, row % 2, 1]
        for c in range(width):
            keys[c, slot] = qkv[row, width + c]
            values[c, slot] = qkv[row, 2 * width + c]
        for head in range(weights.heads):
            distance = weights.distance[layer, head]
            for s in range(slots):  # a slot behind `now` was never written
                bias[s] = distance[slots - 1 - slot + s] if s <= now else F(-np.inf)
            first = head * each
            channels = slice(first, first + each)
            attend(qkv[row, channels], keys, first, values, first, 0, bias, scores, y[row, channels])


@kernel(reorders=True)
def _sample(weights, normal, steps, face):  # type: ignore[no-untyped-def]
    """Take the Euler steps from noise to a face, in place, under the normalised state of the backbone."""
    rows, sessions = normal.shape[0], face.shape[0]
    blocks, width = weights.head_down.bias.shape
    condition, bent = np.empty((rows, width), F), np.empty((rows, width), F)
    steering, shaped = np.empty((rows, 3 * width), F), np.empty((rows, width), F)
    hidden = np.empty((rows, weights.head_up.bias.shape[1]), F)
    one, x, y = np.empty((sessions, width), F), np.empty((rows, width), F), np.empty((rows, width), F)
    clean = np.empty((rows, face.shape[1]), F)
    product(normal, weights.condition, 0, condition)
    for step in range(steps.shares.shape[0]):
        for row in range(rows):
            for c in range(width):
                bent[row, c] = silu(condition[row, c] + steps.times[step, c])
        product(face, weights.noisy, 0, one)
        _repeat(one, x)
        for block in range(blocks):
            product(bent, weights.steer, block, steering)  # shift, scale, gate
            _normalise(x, F(1e-6), shaped)
            for row in range(rows):
                for c in range(width):
                    shaped[row, c] = shaped[row, c] * (ONE + steering[row, width + c]) + steering[row, c]
            product(shaped, weights.head_up, block, hidden)
            _gelu(hidden)
            product(hidden, weights.head_down, block, y)
            for row in range(rows):
                for c in range(width):
                    x[row, c] += steering[row, 2 * width + c] * y[row, c]
        _normalise(x, F(1e-5), shaped)
        product(shaped, weights.face, 0, clean)
        for session in range(sessions):
            without, with_sound = clean[2 * session], clean[2 * session + 1]
            for c in range(face.shape[1]):
                guided = without[c] + steps.guidance * (with_sound[c] - without[c])
                face[session, c] += (guided - face[session, c]) * steps.shares[step]


@kernel(reorders=True)
def run_frames(weights, ring, seen, chosen, heard, noise, last, steps, frames):  # type: ignore[no-untyped-def]
    """Fill `frames` (b, t, c) of the `chosen` sessions from `noise` (b, t, c), `heard` (b, t, w), `last` frames (b, c).

    A `ring` (b, l, 2, 2, w, n) holds keys and values, slots last: frame k of a session, of which `seen` (b) are past,
    lies in slot k mod n.
    """
    sessions, count, width = chosen.shape[0], heard.shape[1], heard.shape[2]
    rows = 2 * sessions
    one, x, y = np.empty((sessions, width), F), np.empty((rows, width), F), np.empty((rows, width), F)
    qkv, added = np.empty((rows, 3 * width), F), np.empty((rows, width), F)
    hidden, scores = np.empty((rows, weights.up.bias.shape[1]), F), np.empty(ring.shape[5], F)
    face = last[chosen]
    for i in range(count):
        product(face, weights.embed, 0, one)
        _repeat(one, x)
        for layer in range(weights.qkv.bias.shape[0]):
            for k in range(sessions):
                for c in range(width):
                    x[2 * k + 1, c] += heard[chosen[k], i, c]
            _normalise(x, F(1e-5), y)
            product(y, weights.qkv, layer, qkv)
            _look_back(weights, layer, ring, seen, chosen, i, qkv, scores, y)
            product(y, weights.project, layer, added)
            for row in range(rows):
                for c in range(width):
                    x[row, c] += added[row, c]
            _normalise(x, F(1e-5), y)
            product(y, weights.up, layer, hidden)
            _gelu(hidden)
            product(hidden, weights.down, layer, added)
            for row in range(rows):
                for c in range(width):
                    x[row, c] += added[row, c]
        _normalise(x, F(1e-5), y)
        for k in range(sessions):
            for c in range(face.shape[1]):
                face[k, c] = noise[chosen[k], i, c]
        _sample(weights, y, steps, face)
        for k in range(sessions):
            for c in range(face.shape[1]):
                frames[chosen[k], i, c] = face[k, c]


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


def _plain(linear: nn.Module) -> Affine:
    assert isinstance(linear, nn.Linear)
    return Affine(linear.weight.detach().numpy().T, linear.bias.detach().numpy())


def _folded(norm: nn.Module, linear: nn.Module) -> Affine:
    """The projection of a plainly normalised x that equals linear(norm(x))."""
    assert isinstance(norm, nn.LayerNorm)
    weight, bias = _plain(linear)
    gain, shift = norm.weight.detach().numpy(), norm.bias.detach().numpy()
    return Affine(gain[:, None] * weight, shift @ weight + bias)


def _scaled_queries(qkv: Affine, attention: nn.Module) -> Affine:
    """The scores' 1 / sqrt(d) is folded into the queries."""
    assert isinstance(attention, RingAttention)
    scale = np.ones_like(qkv.bias)
    scale[: attention.width] = (attention.width // attention.heads) ** -0.5
    return Affine(qkv.weight * scale, qkv.bias * scale)


def _split(whole: Affine, parts: int) -> Matrices:
    """One projection as several of equal width."""
    weights, biases = np.split(whole.weight, parts, axis=1), np.split(whole.bias, parts)
    return _stacked([Affine(weight, bias) for weight, bias in zip(weights, biases, strict=True)])


def _chain(first: Affine, second: Affine) -> Affine:
    return Affine(first.weight @ second.weight, first.bias @ second.weight + second.bias)


def _stacked(maps: Sequence[Affine]) -> Matrices:
    weights, biases = np.stack([one.weight.T for one in maps]), np.stack([one.bias for one in maps])
    return Matrices(np.ascontiguousarray(weights, F), np.ones(biases.shape, F), np.ascontiguousarray(biases, F))
