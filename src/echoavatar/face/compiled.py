"""The face model's frame loop in the ring form, compiled by numba: eight frames, each some hundred tiny products.

Computes what `FaceGpt` and `FlowHead` compute. Rows are sessions x guidance branches; matrices lie in tiles of (inputs,
64 outputs), and products go tile by tile to the BLAS that SciPy brings: small enough that it starts no threads of its
own, which would get in torch's way, yet many rows at once. Sessions go through in groups whose intermediate results
stay in the cache; keys and values are written where they stay, and read there.
"""

import math
from typing import NamedTuple

import numpy as np

from ..nn.compiled import NOTHING, ONE, ZERO, F, compiled, exponential, gelu, silu
from ..nn.octet import ask_for, most, scratch, spread
from ..nn.wide import WIDE, exponentials, gelus, highest, narrowed, put, total, wide, widened, with_product

GROUP = 32  # sessions
TILE = 64  # outputs: with 256 inputs as fast as any for 2 rows and for 64
ONE_THREAD = 2**18  # multiplications up to which OpenBLAS takes no further threads
LINE = 32  # halves that come from memory together


class Affine(NamedTuple):
    """x W + b, of one layer or of several."""

    tiles: np.ndarray  # (l, k, i, TILE) float32: the columns of W, filled up with zeros
    bias: np.ndarray  # (l, o)


class Weights(NamedTuple):
    """A frozen ring form; norm weights are folded into the products that follow them."""

    embed: Affine
    qkv: Affine
    project: Affine
    up: Affine
    down: Affine
    condition: Affine
    steer: Affine  # of each block
    noisy: Affine
    head_up: Affine
    head_down: Affine
    face: Affine
    distance: np.ndarray  # (l, h, 2 n) bias of scores by how far back a slot lies; see `FrameDecoder`
    own: np.ndarray  # (l, h) that of the frame itself
    heads: int


class Steps(NamedTuple):
    """The Euler steps from noise to a face."""

    times: np.ndarray  # (n, w) what steering adds for the time
    shares: np.ndarray  # (n,) of the way to the face that the network sees
    guidance: np.float32


@compiled()
def run_frames(weights, ring, seen, chosen, heard, noise, last, steps, frames):  # type: ignore[no-untyped-def]
    """Fill `frames` (b, t, c) of the `chosen` sessions from `noise` (b, t, c), `heard` (b, t, w), `last` frames (b, c).

    A `ring` (b, l, 2, 2, w n) holds keys, channel by channel, and values, head by head, of each slot by slot: frame k
    of a session, of which `seen` (b) are past, lies in slot k mod n.
    """
    for first in range(0, chosen.shape[0], GROUP):
        _run_group(weights, ring, seen, chosen[first : first + GROUP], heard, noise, last, steps, frames)


@compiled()
def _run_group(weights, ring, seen, chosen, heard, noise, last, steps, frames):  # type: ignore[no-untyped-def]
    """The same for a few sessions, whose rows lie side by side: without sound, with sound."""
    sessions, rows, count, width = chosen.shape[0], 2 * chosen.shape[0], heard.shape[1], heard.shape[2]
    one, x, y = np.empty((sessions, width), F), np.empty((rows, width), F), np.empty((rows, width), F)
    qkv, added = np.empty((rows, 3 * width), F), np.empty((rows, width), F)
    hidden = np.empty((rows, weights.up.bias.shape[1]), F)
    face = np.empty((sessions, last.shape[1]), F)
    for k in range(sessions):
        for c in range(face.shape[1]):
            face[k, c] = last[chosen[k], c]
    for i in range(count):
        _product(face, weights.embed, 0, one)
        _repeat(one, x)
        for layer in range(weights.qkv.bias.shape[0]):
            for k in range(sessions):
                for c in range(width):
                    x[2 * k + 1, c] += heard[chosen[k], i, c]
            _normalise(x, F(1e-5), y)
            _product(y, weights.qkv, layer, qkv)
            _look_back(weights, layer, ring, seen, chosen, i, qkv, y)
            _add_product(y, weights.project, layer, added, x)
            _normalise(x, F(1e-5), y)
            _product(y, weights.up, layer, hidden)
            _gelu(hidden)
            _add_product(hidden, weights.down, layer, added, x)
        _normalise(x, F(1e-5), y)
        for k in range(sessions):
            for c in range(face.shape[1]):
                face[k, c] = noise[chosen[k], i, c]
        _sample(weights, y, steps, face)
        for k in range(sessions):
            for c in range(face.shape[1]):
                frames[chosen[k], i, c] = face[k, c]


@compiled(_nrt=False)  # arrays are not counted: see `octet`
def _look_back(weights, layer, ring, seen, chosen, i, qkv, y):  # type: ignore[no-untyped-def]
    """Mix what each head of each row sees into y (r, w), and put the row's keys and values into their slot.

    That comes after the head's others were read, which brings them near: written first, each would wait for memory.
    What the head reads for the next row is asked for meanwhile.
    """
    rows, width = y.shape
    slots, each = ring.shape[4] // width, width // weights.heads
    scores, young = scratch((slots,)), scratch((slots,))
    for row in range(rows):
        session, following = chosen[row // 2], min(row + 1, rows - 1)
        now = seen[session] + i
        slot = now % slots
        keys, values = ring[session, layer, row % 2, 0], ring[session, layer, row % 2, 1]
        later = ring[chosen[following // 2], layer, following % 2]
        for head in range(weights.heads):
            first, own = head * each, weights.own[layer, head]
            for place in range(first * slots, (first + each) * slots, LINE):
                ask_for(later, (0,), place)
                ask_for(later, (1,), place)
            bias = weights.distance[layer, head, slots - 1 - slot : 2 * slots - 1 - slot]
            if now < slots:  # slots that nothing was written to
                for s in range(slots):
                    young[s] = bias[s] if s < now else -np.inf
                bias = young
            rest = _weigh(qkv[row], first, each, keys, slot, bias, own, scores)
            _mix(qkv[row], first, each, values, slot, scores, rest, y[row])


@compiled(_nrt=False)
def _weigh(qkv, first, each, keys, slot, bias, own, scores):  # type: ignore[no-untyped-def]
    """One head's shares of what is in the ring, into `scores` (n); that of the frame itself is returned.

    Its key goes to `slot` of `keys` (w n). `bias` (n) is -inf where a slot is not to be seen, as is that one; `own` is
    the frame's.
    """
    slots, last, key = scores.shape[0], first + each, qkv.shape[0] // 3 + first
    for i in range(each):
        own += qkv[first + i] * widened(narrowed(qkv[key + i]))
    top = wide(bias, (0,))
    for s in range(0, slots, WIDE):
        score, other = wide(bias, (s,)), wide(keys, (first * slots + s,)) * qkv[first]
        for i in range(first + 1, last - 1, 2):
            score = with_product(score, qkv[i], wide(keys, (i * slots + s,)))
            other = with_product(other, qkv[i + 1], wide(keys, (i * slots + slots + s,)))
        if each % 2 == 0:
            score = with_product(score, qkv[last - 1], wide(keys, ((last - 1) * slots + s,)))
        score = score + other
        put(scores, (s,), score)
        top = most(top, score)
    best = max(highest(top), own)
    mass, mine = spread(ZERO, top), exponential(own - best)
    for s in range(0, slots, WIDE):
        share = most(exponentials(wide(scores, (s,)) - best) - NOTHING, ZERO)
        put(scores, (s,), share)
        mass = mass + share
    per_mass = ONE / (total(mass) + mine)
    for s in range(0, slots, WIDE):
        put(scores, (s,), wide(scores, (s,)) * per_mass)
    for i in range(each):
        keys[(first + i) * slots + slot] = narrowed(qkv[key + i])
    return mine * per_mass


@compiled(_nrt=False)
def _mix(qkv, first, each, values, slot, scores, own, y):  # type: ignore[no-untyped-def]
    """Shares `scores` (n) of a head's `values` (w n) and `own` of the frame's, which go to `slot`, into y (w)."""
    slots, value = scores.shape[0], 2 * y.shape[0] + first
    whole = each // WIDE * WIDE
    for i in range(0, whole, WIDE):
        a = b = c = d = spread(ZERO, wide(scores, (0,)))
        for s in range(0, slots, 4):
            at = first * slots + s * each + i
            a = with_product(a, scores[s], wide(values, (at,)))
            b = with_product(b, scores[s + 1], wide(values, (at + each,)))
            c = with_product(c, scores[s + 2], wide(values, (at + 2 * each,)))
            d = with_product(d, scores[s + 3], wide(values, (at + 3 * each,)))
        put(y, (first + i,), (a + b) + (c + d))
    for i in range(whole, each):
        y[first + i] = ZERO
        for s in range(slots):
            y[first + i] += scores[s] * widened(values[first * slots + s * each + i])
    for i in range(each):
        kept = narrowed(qkv[value + i])
        y[first + i] += own * widened(kept)
        values[first * slots + slot * each + i] = kept


@compiled()
def _sample(weights, normal, steps, face):  # type: ignore[no-untyped-def]
    """Euler steps from noise to a face, in place; the guidance branches of a session lie side by side."""
    rows, sessions = normal.shape[0], face.shape[0]
    blocks, width = weights.head_down.bias.shape
    condition, bent = np.empty((rows, width), F), np.empty((rows, width), F)
    steering, shaped = np.empty((rows, 3 * width), F), np.empty((rows, width), F)
    hidden = np.empty((rows, weights.head_up.bias.shape[1]), F)
    one, x, y = np.empty((sessions, width), F), np.empty((rows, width), F), np.empty((rows, width), F)
    seen = np.empty((rows, face.shape[1]), F)
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
        _product(shaped, weights.face, 0, seen)
        for session in range(sessions):
            without, with_sound = seen[2 * session], seen[2 * session + 1]
            for c in range(face.shape[1]):
                guided = without[c] + steps.guidance * (with_sound[c] - without[c])
                face[session, c] += (guided - face[session, c]) * steps.shares[step]


@compiled()
def _product(x, affine, layer, y):  # type: ignore[no-untyped-def]
    """Rows times W plus bias; a tile stays near while all rows pass."""
    tiles, bias = affine.tiles[layer], affine.bias[layer]
    block = max(1, min(y.shape[0], ONE_THREAD // tiles[0].size))
    part = np.empty((block, TILE), F)
    for tile in range(tiles.shape[0]):
        left = tile * TILE
        columns = min(TILE, y.shape[1] - left)
        for start in range(0, y.shape[0], block):
            rows = min(block, y.shape[0] - start)
            np.dot(x[start : start + rows], tiles[tile], part[:rows])
            for row in range(rows):
                for o in range(columns):
                    y[start + row, left + o] = part[row, o] + bias[left + o]


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
    whole = x.shape[1] // WIDE * WIDE
    for row in range(x.shape[0]):
        for i in range(0, whole, WIDE):
            put(x, (row, i), gelus(wide(x, (row, i))))
        for i in range(whole, x.shape[1]):
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
