"""The decoder's inner loop on a CPU, compiled: codes are drawn one after another, and each is read back at once.

One code takes a few million multiplications, which is less work than calling the two hundred operations of torch that
describe it. Each weight is read once for all rows. A row's sums run in the same order whatever its neighbours are.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from echoavatar.nn.kernel_math import HALF, ONE, ZERO, F, Matrices, attend, exponential, product, silu
from echoavatar.nn.kernels import kernel

from ..noise import FIRST, GOLDEN, SECOND

BISECTIONS = 40


class Weights(NamedTuple):
    """A frozen generator; norm scales are folded into the products that follow them."""

    embedding: Matrices  # (1, v, c); its scales are those of its rows
    qkv: Matrices
    out: Matrices
    gate_up: Matrices
    down: Matrices
    heads: Matrices  # (segments, K, c)
    starts: np.ndarray  # (segments,) the id of each segment's first code
    eps: np.float32  # c times the norm's epsilon


class Positions(NamedTuple):
    """The positions of the drawn codes: their rotary phases, their slots in the ring, and which slots they see."""

    rotations: np.ndarray  # (b, t, half) complex64, of length 1
    slots: np.ndarray  # (b, t)
    bias: np.ndarray  # (b, t, s) 0 where a slot is seen, -inf where not


class Draws(NamedTuple):
    """How codes are drawn."""

    noise: np.ndarray  # (b, n, K), or (b, n, 0) for noise that follows from the keys
    keys: np.ndarray  # (b,) uint64 of the seeds
    starts: np.ndarray  # (b,) the absolute position of the first code
    sharpness: np.ndarray  # (b, layers of the RVQ)
    top_p: np.ndarray  # (b,)


class Steering(NamedTuple):
    """The effect of a directive; see the lab's `exemplar.Steer`."""

    segments: np.ndarray  # (s,) the segments whose logits it raises; negative without a directive
    hint: np.ndarray  # (b, c)
    raised: np.ndarray  # (b, g, s K)
    bias: np.ndarray  # (b, s K)
    gates: np.ndarray  # (g, c)
    gate_biases: np.ndarray  # (g,)


@kernel(reorders=True)
def _normalise(x, eps, y):  # type: ignore[no-untyped-def]
    for row in range(x.shape[0]):
        total = ZERO
        for i in range(x.shape[1]):
            total += x[row, i] * x[row, i]
        scale = ONE / F(math.sqrt(total + eps))
        for i in range(x.shape[1]):
            y[row, i] = x[row, i] * scale


@kernel(reorders=True)
def _rotate(qkv, rotation, count):  # type: ignore[no-untyped-def]
    """Rotary positions of the first `count` channels: each head's pairs, as complex numbers, times the rotation."""
    half = rotation.shape[0]
    for start in range(0, count, 2 * half):
        for i in range(half):
            first, second = qkv[start + 2 * i], qkv[start + 2 * i + 1]
            qkv[start + 2 * i] = first * rotation[i].real - second * rotation[i].imag
            qkv[start + 2 * i + 1] = first * rotation[i].imag + second * rotation[i].real


@kernel(reorders=True)
def _attend(qkv, keys, values, slot, bias, scores, y):  # type: ignore[no-untyped-def]
    """Write k and v into the ring, and what every head sees into y."""
    kv_heads, width, _ = keys.shape
    group = y.shape[0] // width // kv_heads
    for kv in range(kv_heads):
        k = y.shape[0] + kv * width
        v = k + kv_heads * width
        for i in range(width):
            keys[kv, i, slot] = qkv[k + i]
            values[kv, i, slot] = qkv[v + i]
        for start in range(kv * group * width, (kv + 1) * group * width, width):
            head = slice(start, start + width)
            attend(qkv[head], keys[kv], 0, values[kv], 0, 0, bias, scores, y[head])


@kernel(reorders=True)
def _steer(logits, hidden, steering, at):  # type: ignore[no-untyped-def]
    for row in range(logits.shape[0]):
        for code in range(logits.shape[1]):
            logits[row, code] += steering.bias[row, at + code]
        for number in range(steering.gates.shape[0]):
            gate = steering.gate_biases[number]
            for i in range(hidden.shape[1]):
                gate += hidden[row, i] * steering.gates[number, i]
            for code in range(logits.shape[1]):
                logits[row, code] += gate * steering.raised[row, number, at + code]


@kernel()
def _mix(x):  # type: ignore[no-untyped-def]
    """`noise.mix` of one number."""
    x = (x ^ (x >> np.uint64(30))) * FIRST
    x = (x ^ (x >> np.uint64(27))) * SECOND
    return x ^ (x >> np.uint64(31))


@kernel()
def _gumbel(key, counter):  # type: ignore[no-untyped-def]
    """Gumbel noise from the number that `noise.uniform_noise` has at this place; only codes that may win ask for it."""
    word = _mix(key + np.uint64(counter + 1) * GOLDEN) >> np.uint64(11)
    return F(-math.log(-math.log((float(word) + 0.5) * 2.0**-53)))


@kernel(reorders=True)
def _least_share(shares, wanted):  # type: ignore[no-untyped-def]
    """The largest share such that codes with at least this share still sum to `wanted`; bisection beats sorting."""
    low, high = ZERO, F(1.5)
    for _ in range(BISECTIONS):
        middle = HALF * (low + high)
        mass = ZERO
        for code in range(shares.shape[0]):
            mass += shares[code] if shares[code] >= middle else ZERO
        if mass >= wanted:
            low = middle
        else:
            high = middle
    return low


@kernel(reorders=True)
def _draw(logits, noise, key, position, sharpness, top_p, shares):  # type: ignore[no-untyped-def]
    """The code with the largest logit plus noise within the nucleus (the lab's `sampling`); `shares` (K) is scratch.

    Without `noise` (K), that of the key at this absolute position.
    """
    highest = F(-np.inf)
    for code in range(logits.shape[0]):
        logits[code] *= sharpness
        highest = max(highest, logits[code])
    total = ZERO
    for code in range(logits.shape[0]):
        shares[code] = exponential(logits[code] - highest)
        total += shares[code]
    least = _least_share(shares, top_p * total) if top_p < ONE else ZERO
    best, code_of_best = F(-np.inf), 0
    for code in range(logits.shape[0]):
        if shares[code] >= least:
            own = noise[code] if len(noise) else _gumbel(key, position * len(logits) + code)
            if logits[code] + own > best:
                best, code_of_best = logits[code] + own, code
    return code_of_best


@kernel(reorders=True)
def _read(weights, x, keys, values, at, index, hidden):  # type: ignore[no-untyped-def]
    """Pass x (b, c) through the layers at one position; the normed hidden state goes into `hidden`."""
    rows, width = x.shape
    y, qkv = np.empty((rows, width), F), np.empty((rows, weights.qkv.weight.shape[1]), F)
    gates = np.empty((rows, weights.gate_up.weight.shape[1]), F)
    inner, scores = gates.shape[1] // 2, np.empty(at.bias.shape[2], F)
    for layer in range(weights.qkv.weight.shape[0]):
        _normalise(x, weights.eps, hidden)
        product(hidden, weights.qkv, layer, qkv)
        for row in range(rows):
            rotation, slot, bias = at.rotations[row, index], at.slots[row, index], at.bias[row, index]
            _rotate(qkv[row], rotation, qkv.shape[1] - keys[layer].shape[1] * keys[layer].shape[2])
            _attend(qkv[row], keys[layer][row], values[layer][row], slot, bias, scores, y[row])
        product(y, weights.out, layer, hidden)
        for row in range(rows):
            for i in range(width):
                x[row, i] += hidden[row, i]
        _normalise(x, weights.eps, hidden)
        product(hidden, weights.gate_up, layer, gates)
        for row in range(rows):
            for i in range(inner):
                gates[row, i] = silu(gates[row, i]) * gates[row, inner + i]
        product(gates, weights.down, layer, hidden)
        for row in range(rows):
            for i in range(width):
                x[row, i] += hidden[row, i]
    _normalise(x, weights.eps, hidden)


@kernel()  # not reordered: the product is rounded before anything is added to it
def _embed(embedding, at, x):  # type: ignore[no-untyped-def]
    for i in range(x.shape[0]):
        x[i] = F(embedding.weight[0, at, i]) * embedding.scale[0, at]


@kernel(reorders=True)
def _draw_codes(weights, hidden, keys, values, at, draws, steering, codes):  # type: ignore[no-untyped-def]
    rows, width = hidden.shape
    segments, count = weights.heads.weight.shape[0], codes.shape[1]
    x = np.empty((rows, width), F)
    logits, shares = np.empty((rows, weights.heads.weight.shape[1]), F), np.empty(weights.heads.weight.shape[1], F)
    for index in range(count):
        segment = index % segments
        product(hidden, weights.heads, segment, logits)
        for place in range(steering.segments.shape[0]):
            if segment == steering.segments[place]:
                _steer(logits, hidden, steering, place * logits.shape[1])
        for row in range(rows):
            sharpness = draws.sharpness[row, index % draws.sharpness.shape[1]]
            noise, position = draws.noise[row, index], draws.starts[row] + index
            key, top_p = draws.keys[row], draws.top_p[row]
            codes[row, index] = _draw(logits[row], noise, key, position, sharpness, top_p, shares)
        if index == count - 1:
            return
        for row in range(rows):
            _embed(weights.embedding, weights.starts[segment] + codes[row, index], x[row])
            for i in range(width):
                x[row, i] += steering.hint[row, i]
        _read(weights, x, keys, values, at, index, hidden)


def read_position(
    weights: Weights, x: np.ndarray, keys: Sequence[np.ndarray], values: Sequence[np.ndarray], at: Positions
) -> np.ndarray:
    """The normed hidden state (b, c) of one embedded position x (b, c); keys and values are written in place."""
    hidden, at = np.empty_like(x), Positions(*map(np.ascontiguousarray, at))
    _read(weights, x.copy(), _padded(keys), _padded(values), at, 0, hidden)
    return hidden


def draw_codes(
    weights: Weights,
    hidden: np.ndarray,
    keys: Sequence[np.ndarray],
    values: Sequence[np.ndarray],
    at: Positions,
    draws: Draws,
    steering: Steering,
) -> np.ndarray:
    """Codes (b, n) from the hidden state (b, c) of the position that predicts the first.

    Keys and values (b, kv, d, s) of each layer are written in place; the last code is not read back.
    """
    codes = np.zeros(draws.noise.shape[:2], np.int64)
    _draw_codes(
        weights,
        hidden.copy(),
        _padded(keys),
        _padded(values),
        Positions(*map(np.ascontiguousarray, at)),  # one memory layout, so one compilation
        Draws(*map(np.ascontiguousarray, draws)),
        steering,
        codes,
    )
    return codes


def _padded(rings: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """The rings padded to a multiple of eight, because numba compiles anew for every length of a tuple."""
    return (*rings, *[rings[-1]] * (-len(rings) % 8))
