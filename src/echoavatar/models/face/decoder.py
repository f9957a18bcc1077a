"""The face model's frames of one chunk (ring form): weights frozen for the compiled loop, and the memory it works in.

Computes what the lab's `FaceGpt` and `FlowHead` compute (a test compares them), with the norms' weights folded into the
next projection. The compiled loop runs over a chunk's frames, each some hundred small matrix products. Its rows are
sessions x guidance branches: 2 k is session k without sound, 2 k + 1 the same with sound.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from echoavatar.errors import CheckpointError
from echoavatar.nn import StreamState
from echoavatar.nn.kernel_math import ONE, ZERO, F, Matrices, attend, gelu, product, silu
from echoavatar.nn.kernels import kernel

from .config import FaceConfig
from .noise import euler_levels


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
    """Repeat each session's row for both guidance branches."""
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


@dataclass
class RingState(StreamState):
    """All zero: the mean face, nothing heard yet.

    `ring` holds keys and values (in this order), per layer and guidance branch. Frame k of a session lies in slot k mod
    n and is written once.
    """

    ring: Float[np.ndarray, "b l 2 2 w n"]
    last: Float[np.ndarray, "b c"]  # frame, normalised
    seen: Int[np.ndarray, " b"]  # frames generated


class FrameDecoder:
    """Runs the weights of a face model, given under the names that they have in its checkpoint, in float32."""

    def __init__(self, config: FaceConfig, weights: Mapping[str, Float[np.ndarray, "..."]]) -> None:
        """Raises CheckpointError if a weight is missing or of another shape: the loop looks at no bounds."""

        def taken(name: str, *shape: int) -> Float[np.ndarray, "..."]:
            if name not in weights or weights[name].shape != shape:
                has = weights[name].shape if name in weights else "missing"
                raise CheckpointError(f"the face's {name} is {has}, wanted {shape}; copy or download it again")
            return weights[name]

        def plain(name: str, inputs: int, outputs: int) -> Affine:
            return Affine(taken(f"{name}.weight", outputs, inputs).T, taken(f"{name}.bias", outputs))

        def folded(norm: str, name: str, inputs: int, outputs: int) -> Affine:
            """The projection of a plainly normalised x that equals linear(norm(x))."""
            gain, shift = taken(f"{norm}.weight", inputs), taken(f"{norm}.bias", inputs)
            linear = plain(name, inputs, outputs)
            return Affine(gain[:, None] * linear.weight, shift @ linear.weight + linear.bias)

        self.config, heads = config, config.heads
        width, inner, told, curves = config.width, config.head_width, config.condition, config.channels
        blocks = [f"gpt.blocks.{index}" for index in range(config.layers)]
        mlps = [f"head.mlps.{index}" for index in range(config.head_blocks)]
        qkv = [folded(f"{block}.norm1", f"{block}.attn.qkv", width, 3 * width) for block in blocks]
        scale = np.repeat([(width // heads) ** -0.5, 1, 1], width).astype(F)  # of the scores, folded into the queries
        told_by = folded("gpt.output_norm", "gpt.output_proj", width, told)
        self._weights = Weights(
            embed=_stacked([plain("gpt.embed", curves, width)]),
            qkv=_stacked([Affine(one.weight * scale, one.bias * scale) for one in qkv]),
            project=_stacked([plain(f"{block}.attn.proj", width, width) for block in blocks]),
            up=_stacked([folded(f"{block}.norm2", f"{block}.mlp.fc1", width, 4 * width) for block in blocks]),
            down=_stacked([plain(f"{block}.mlp.fc2", 4 * width, width) for block in blocks]),
            condition=_stacked([_chain(told_by, plain("head.condition_proj", told, inner))]),
            steer=_split(plain("head.by_condition", inner, 3 * inner * len(mlps)), len(mlps)),
            noisy=_stacked([plain("head.noisy_proj", curves, inner)]),
            head_up=_stacked([plain(f"{mlp}.fc1", inner, 4 * inner) for mlp in mlps]),
            head_down=_stacked([plain(f"{mlp}.fc2", 4 * inner, inner) for mlp in mlps]),
            face=_stacked([folded("head.output_norm", "head.output_proj", inner, curves)]),
            distance=np.tile([taken(f"{block}.attn.bias", heads, config.context) for block in blocks], 2).astype(F),
            heads=heads,
        )
        times, levels = euler_levels(config.sampling_steps)
        before, after = np.array(levels[:-1]), np.array(levels[1:])
        shares = (before - after) / (before + 1e-9)
        embedded = _embedded(times, plain("head.time_in", inner, inner), plain("head.time_out", inner, inner))
        self._steps = Steps(embedded.astype(F), shares.astype(F), F(config.guidance))

    def init_state(self, rows: int) -> RingState:
        """Nothing seen yet."""
        config = self.config
        ring = np.zeros((rows, config.layers, 2, 2, config.width, config.context), F)
        return RingState(ring, np.zeros((rows, config.channels), F), np.zeros(rows, np.int64))

    def step(
        self,
        heard: Float[np.ndarray, "b t w"],
        state: RingState,
        active: Bool[np.ndarray, " b"],
        noise: Float[np.ndarray, "b t c"],
    ) -> Float[np.ndarray, "b t c"]:
        """The next normalised frames of active rows, zeros elsewhere. CheckpointError: `heard` has another shape."""
        if heard.shape != (wanted := (*noise.shape[:2], self.config.width)):
            raise CheckpointError(f"the face's ear gives {heard.shape}, wanted {wanted}; copy or download it again")
        chosen, frames = np.flatnonzero(active), np.zeros((*heard.shape[:2], noise.shape[2]), F)
        heard, noise = (np.ascontiguousarray(part, F) for part in (heard, noise))
        run_frames(self._weights, state.ring, state.seen, chosen, heard, noise, state.last, self._steps, frames)
        state.last[active] = frames[active, -1]
        state.seen[active] += frames.shape[1]
        return frames


def _embedded(times: Sequence[float], first: Affine, second: Affine) -> Float[np.ndarray, "n w"]:
    """The embedding of times, cut to whole ones, as the lab's `FlowHead.embed_time` computes it."""
    half = len(first.bias) // 2
    angles = np.trunc(times)[:, None] * np.exp(-math.log(10_000) * np.arange(half) / half)
    x = np.concatenate([np.cos(angles), np.sin(angles)], 1) @ first.weight + first.bias
    return np.asarray(x / (1 + np.exp(-x)) @ second.weight + second.bias)


def _split(whole: Affine, parts: int) -> Matrices:
    """One projection as several of equal width."""
    weights, biases = np.split(whole.weight, parts, axis=1), np.split(whole.bias, parts)
    return _stacked([Affine(weight, bias) for weight, bias in zip(weights, biases, strict=True)])


def _chain(first: Affine, second: Affine) -> Affine:
    return Affine(first.weight @ second.weight, first.bias @ second.weight + second.bias)


def _stacked(maps: Sequence[Affine]) -> Matrices:
    weights, biases = np.stack([one.weight.T for one in maps]), np.stack([one.bias for one in maps])
    return Matrices(np.ascontiguousarray(weights, F), np.ones(biases.shape, F), np.ascontiguousarray(biases, F))
