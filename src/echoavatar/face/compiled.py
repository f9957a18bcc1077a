"""The face model's frame loop in the ring form, compiled by numba: eight frames, each some hundred tiny products.

Computes what `FaceGpt` and `FlowHead` compute. Rows are sessions x guidance branches; matrices lie as (inputs,
outputs), so a product of two rows or of a hundred goes to the BLAS that SciPy brings.
"""

import math
from typing import NamedTuple

import numpy as np

from ..nn.compiled import ONE, ZERO, F, attend, compiled, gelu, silu

ONE_THREAD = 2**18  # multiplications up to which OpenBLAS takes no further threads


class Affine(NamedTuple):
    """x W + b, of one layer or of several."""

    weight: np.ndarray  # (l, i, o) float32
    bias: np.ndarray  # (l, o)


class Weights(NamedTuple):
    """A frozen ring form; norm weights are folded into the products that follow them."""

    embed: Affine
    qkv: Affine
    project: Affine
    up: Affine
    down: Affine
    condition: Affine
    steer: Affine
    noisy: Affine
    head_up: Affine
    head_down: Affine
    face: Affine
    heads: int


class Steps(NamedTuple):
    """The Euler steps from noise to a face."""

    times: np.ndarray  # (n, w) what steering adds for the time
    shares: np.ndarray  # (n,) of the way to the face that the network sees
    guidance: np.float32


@compiled()
def run_frames(weights, keys_values, biases, past, heard, noise, last, steps, frames):  # type: ignore[no-untyped-def]
    """Fill `frames` (b, t, c) from `noise` (b, t, c), what each row heard (r, t, w) and the `last` frame (b, c).

    Keys and values are one array (l, r, 2w, past + t), biases of scores another (l, r, h, t, past + 1).
    """
    rows, count, width = heard.shape
    sessions = noise.shape[0]
    lookback = biases.shape[4] - 1
    one, x, y = np.empty((sessions, width), F), np.empty((rows, width), F), np.empty((rows, width), F)
    qkv, added = np.empty((rows, 3 * width), F), np.empty((rows, width), F)
    hidden = np.empty((rows, weights.up.weight.shape[2]), F)
    scores = np.empty(lookback + 1, F)
    face = last.copy()
    for i in range(count):
        _product(face, weights.embed, 0, one)
        _repeat(one, x)
        for layer in range(weights.qkv.weight.shape[0]):
            for row in range(rows):
                for c in range(width):
                    x[row, c] += heard[row, i, c]
            _normalise(x, F(1e-5), y)
            _product(y, weights.qkv, layer, qkv)
            for row in range(rows):
                cache = keys_values[layer, row]
                for c in range(2 * width):
                    cache[c, past + i] = qkv[row, width + c]
                each = width // weights.heads
                for head in range(weights.heads):
                    c = head * each
                    query, mixed = qkv[row, c : c + each], y[row, c : c + each]
                    bias = biases[layer, row, head, i]
                    attend(query, cache, c, cache, width + c, past + i - lookback, bias, scores, mixed)
            _add_product(y, weights.project, layer, added, x)
            _normalise(x, F(1e-5), y)
            _product(y, weights.up, layer, hidden)
            _gelu(hidden)
            _add_product(hidden, weights.down, layer, added, x)
        _normalise(x, F(1e-5), y)
        for session in range(sessions):
            for c in range(face.shape[1]):
                face[session, c] = noise[session, i, c]
        _sample(weights, y, steps, face)
        for session in range(sessions):
            for c in range(face.shape[1]):
                frames[session, i, c] = face[session, c]


@compiled()
def _sample(weights, normal, steps, face):  # type: ignore[no-untyped-def]
    """Euler steps from noise to a face, in place; the guidance branches of a session lie side by side."""
    rows, sessions = normal.shape[0], face.shape[0]
    blocks, width = weights.head_up.weight.shape[0], weights.head_up.weight.shape[1]
    condition, bent = np.empty((rows, width), F), np.empty((rows, width), F)
    steering = np.empty((rows, weights.steer.weight.shape[2]), F)
    hidden = np.empty((rows, weights.head_up.weight.shape[2]), F)
    one, x, y = np.empty((sessions, width), F), np.empty((rows, width), F), np.empty((rows, width), F)
    seen = np.empty((rows, face.shape[1]), F)
    _product(normal, weights.condition, 0, condition)
    for step in range(steps.shares.shape[0]):
        for row in range(rows):
            for c in range(width):
                bent[row, c] = silu(condition[row, c] + steps.times[step, c])
        _product(bent, weights.steer, 0, steering)
        _product(face, weights.noisy, 0, one)
        _repeat(one, x)
        for block in range(blocks):
            at = 3 * block * width  # shift, scale, gate
            _normalise(x, F(1e-6), bent)
            for row in range(rows):
                for c in range(width):
                    bent[row, c] = (
                        bent[row, c] * (ONE + steering[row, at + width + c]) + steering[row, at + c]
                    )
            _product(bent, weights.head_up, block, hidden)
            _gelu(hidden)
            _product(hidden, weights.head_down, block, y)
            for row in range(rows):
                for c in range(width):
                    x[row, c] += steering[row, at + 2 * width + c] * y[row, c]
        _normalise(x, F(1e-5), bent)
        _product(bent, weights.face, 0, seen)
        for session in range(sessions):
            without, with_sound = seen[2 * session], seen[2 * session + 1]
            for c in range(face.shape[1]):
                guided = without[c] + steps.guidance * (with_sound[c] - without[c])
                face[session, c] += (guided - face[session, c]) * steps.shares[step]


@compiled()
def _product(x, affine, layer, y):  # type: ignore[no-untyped-def]
    """Rows times W plus bias, in blocks that the BLAS does in the calling thread: its own would get in torch's way."""
    weight = affine.weight[layer]
    block = max(1, ONE_THREAD // weight.size)
    for start in range(0, y.shape[0], block):
        np.dot(x[start : start + block], weight, y[start : start + block])
    for row in range(y.shape[0]):
        for o in range(y.shape[1]):
            y[row, o] += affine.bias[layer, o]


@compiled()
def _add_product(x, affine, layer, scratch, y):  # type: ignore[no-untyped-def]
    """The same, added to y; `scratch` is as large as y."""
    _product(x, affine, layer, scratch)
    for row in range(y.shape[0]):
        for o in range(y.shape[1]):
            y[row, o] += scratch[row, o]


@compiled()
def _repeat(x, y):  # type: ignore[no-untyped-def]
    """Every session's row for each of its branches."""
    branches = y.shape[0] // x.shape[0]
    for row in range(y.shape[0]):
        for i in range(y.shape[1]):
            y[row, i] = x[row // branches, i]


@compiled()
def _gelu(x):  # type: ignore[no-untyped-def]
    for row in range(x.shape[0]):
        for i in range(x.shape[1]):
            x[row, i] = gelu(x[row, i])


@compiled()
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
