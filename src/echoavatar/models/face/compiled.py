"""The ring form's loop over the frames of a chunk, compiled: eight frames, each some hundred small matrix products.

Computes what `FaceGpt` and `FlowHead` compute. Rows are sessions x guidance branches: 2 k is session k without sound,
2 k + 1 the same with sound.
"""

import math
from typing import NamedTuple

import numpy as np

from echoavatar.nn.kernel_math import ONE, ZERO, F, attend, gelu, silu
from echoavatar.nn.kernels import kernel

ONE_THREAD = 2**18  # multiplications up to which OpenBLAS starts no threads, which would compete with torch's


class Affine(NamedTuple):
    """x W + b, for one layer or several."""

    weight: np.ndarray  # (l, i, o) float32
    bias: np.ndarray  # (l, o)


class Weights(NamedTuple):
    """Frozen weights of the ring form; norm weights are folded into the products that follow them."""

    embed: Affine
    qkv: Affine
    project: Affine
    up: Affine
    down: Affine
    condition: Affine
    steer: Affine  # one layer per block of the head
    noisy: Affine
    head_up: Affine
    head_down: Affine
    face: Affine
    distance: np.ndarray  # (l, h, 2 n) bias of the scores by distance, written twice in a row
    heads: int


class Steps(NamedTuple):
    """The Euler steps from noise to a face."""

    times: np.ndarray  # (n, w) what the time adds to the steering
    shares: np.ndarray  # (n,) how much of the way to the predicted face each step goes
    guidance: np.float32


@kernel(reorders=True)
def _product(x, affine, layer, y):  # type: ignore[no-untyped-def]
    """Write x W + b into y, a few rows at a time."""
    weight, bias = affine.weight[layer], affine.bias[layer]
    block = max(1, ONE_THREAD // weight.size)
    for start in range(0, y.shape[0], block):
        np.dot(x[start : start + block], weight, y[start : start + block])
    for row in range(y.shape[0]):
        for o in range(y.shape[1]):
            y[row, o] += bias[o]


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
    _product(normal, weights.condition, 0, condition)
    for step in range(steps.shares.shape[0]):
        for row in range(rows):
            for c in range(width):
                bent[row, c] = silu(condition[row, c] + steps.times[step, c])
        _product(face, weights.noisy, 0, one)
        _repeat(one, x)
        for block in range(blocks):
            _product(bent, weights.steer, block, steering)  # shift, scale, gate
            _normalise(x, F(1e-6), shaped)
            for row in range(rows):
                for c in range(width):
                    shaped[row, c] = shaped[row, c] * (ONE + steering[row, width + c]) + steering[row, c]
            _product(shaped, weights.head_up, block, hidden)
            _gelu(hidden)
            _product(hidden, weights.head_down, block, y)
            for row in range(rows):
                for c in range(width):
                    x[row, c] += steering[row, 2 * width + c] * y[row, c]
        _normalise(x, F(1e-5), shaped)
        _product(shaped, weights.face, 0, clean)
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
        _product(face, weights.embed, 0, one)
        _repeat(one, x)
        for layer in range(weights.qkv.bias.shape[0]):
            for k in range(sessions):
                for c in range(width):
                    x[2 * k + 1, c] += heard[chosen[k], i, c]
            _normalise(x, F(1e-5), y)
            _product(y, weights.qkv, layer, qkv)
            _look_back(weights, layer, ring, seen, chosen, i, qkv, scores, y)
            _product(y, weights.project, layer, added)
            for row in range(rows):
                for c in range(width):
                    x[row, c] += added[row, c]
            _normalise(x, F(1e-5), y)
            _product(y, weights.up, layer, hidden)
            _gelu(hidden)
            _product(hidden, weights.down, layer, added)
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
