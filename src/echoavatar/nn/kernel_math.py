"""Arithmetic that compiled loops share: products, exponential, gates, softmax, attention of one head; float32."""

from typing import NamedTuple

import numpy as np

from .kernels import kernel

F = np.float32
ZERO, HALF, ONE = F(0.0), F(0.5), F(1.0)
NOTHING = F(1e-30)  # smaller shares become 0: products with them would be denormal numbers, which are very slow


class Matrices(NamedTuple):
    """One kind of linear map in every layer: y = (W x) scale + bias."""

    weight: np.ndarray  # (l, o, i) float32 or int8
    scale: np.ndarray  # (l, o)
    bias: np.ndarray  # (l, o)


@kernel(reorders=True)
def product(x, matrices, layer, y):  # type: ignore[no-untyped-def]
    """Rows of x times W, four outputs a pass; columns of x beyond those of W are not read.

    The four outputs lie a quarter of W apart. So the passes read four long stretches of memory in order, which a
    processor prefetches: large weights come a third faster than with four neighbouring outputs.
    """
    weight, scale, bias = matrices.weight[layer], matrices.scale[layer], matrices.bias[layer]
    outputs = weight.shape[0]
    quarter = outputs // 4
    for o in range(quarter):
        p, q, r = o + quarter, o + 2 * quarter, o + 3 * quarter
        for row in range(x.shape[0]):
            a, b, c, d = ZERO, ZERO, ZERO, ZERO
            for i in range(weight.shape[1]):
                v = x[row, i]
                a += F(weight[o, i]) * v
                b += F(weight[p, i]) * v
                c += F(weight[q, i]) * v
                d += F(weight[r, i]) * v
            y[row, o] = a * scale[o] + bias[o]
            y[row, p] = b * scale[p] + bias[p]
            y[row, q] = c * scale[q] + bias[q]
            y[row, r] = d * scale[r] + bias[r]
    for o in range(4 * quarter, outputs):
        for row in range(x.shape[0]):
            total = ZERO
            for i in range(weight.shape[1]):
                total += F(weight[o, i]) * x[row, i]
            y[row, o] = total * scale[o] + bias[o]


@kernel(reorders=True)
def exponential(x):  # type: ignore[no-untyped-def]
    """e^x to 3e-7, between e^-87 and e^87: a power of two, written as a float's exponent bits, times a polynomial."""
    y = min(max(x * F(1.442695041), F(-126.0)), F(126.0))
    whole = np.floor(y + HALF)
    r = (y - whole) * F(0.6931471806)
    p = ONE + r * (F(0.5) + r * (F(1 / 6) + r * (F(1 / 24) + r * (F(1 / 120) + r * F(1 / 720)))))
    power = np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)
    return (ONE + r * p) * power


@kernel(reorders=True)
def silu(x):  # type: ignore[no-untyped-def]
    """X times its sigmoid."""
    return x / (ONE + exponential(-x))


@kernel(reorders=True)
def gelu(x):  # type: ignore[no-untyped-def]
    """X times the normal distribution function of x; the error function is Abramowitz and Stegun 7.1.26 (to 2e-7)."""
    z = abs(x) * F(0.7071067812)
    t = ONE / (ONE + F(0.3275911) * z)
    p = t * (F(0.254829592) + t * (F(-0.284496736) + t * (F(1.421413741) + t * (F(-1.453152027) + t * F(1.061405429)))))
    return max(x, ZERO) - HALF * abs(x) * p * max(exponential(-z * z) - NOTHING, ZERO)


@kernel(reorders=True)
def softmax(x):  # type: ignore[no-untyped-def]
    """Softmax of a vector, in place; -inf becomes 0."""
    highest = x[0]
    for s in range(x.shape[0]):
        highest = max(highest, x[s])
    mass = ZERO
    for s in range(x.shape[0]):
        x[s] = exponential(x[s] - highest)
        mass += x[s]
    for s in range(x.shape[0]):
        x[s] = x[s] / mass if x[s] > NOTHING else ZERO


@kernel(reorders=True)
def attend(query, keys, key, values, value, first, bias, scores, y):  # type: ignore[no-untyped-def]
    """Write one head's attention into y (d): softmax(query . keys + bias) over the slots, times the values.

    Channel i of slot s is `keys[key + i, first + s]` and `values[value + i, first + s]`. `bias` (slots) is -inf where a
    slot is not seen; `scores` is scratch of the same length.
    """
    width, slots = query.shape[0], bias.shape[0]
    for s in range(slots):  # not as a slice: numba would compile the text of its error, too
        scores[s] = bias[s]
    for i in range(0, width - 3, 4):  # four channels a pass over the scores
        a, b, c, d, k = query[i], query[i + 1], query[i + 2], query[i + 3], key + i
        for s in range(slots):
            scores[s] += (
                a * keys[k, first + s]
                + b * keys[k + 1, first + s]
                + c * keys[k + 2, first + s]
                + d * keys[k + 3, first + s]
            )
    for i in range(width - width % 4, width):
        for s in range(slots):
            scores[s] += query[i] * keys[key + i, first + s]
    softmax(scores)
    for i in range(width):
        total = ZERO
        for s in range(slots):
            total += scores[s] * values[value + i, first + s]
        y[i] = total
