"""Arithmetic of eight at once, and of two times eight, against numpy's, bit by bit."""

import numpy as np
import pytest
from numba.core.errors import TypingError

from echoavatar.nn.compiled import F
from echoavatar.nn.octet import (
    LANES,
    behind,
    exact,
    first_of,
    fused,
    is_any,
    last_of,
    least,
    most,
    root,
    size,
    spread,
    transposed,
    where,
)
from echoavatar.nn.rows import load, number, store

RNG = np.random.default_rng(0)
GIVEN = RNG.standard_normal((2, 2, LANES)).astype(np.float32)  # rows, octets
SHARED = RNG.standard_normal((1, LANES)).astype(np.float32)
S = F(0.3)


@exact()
def _all(row, given, shared, scalar, made):  # type: ignore[no-untyped-def]
    a, b, c = load(given, (row, 0)), load(given, (row, 1)), load(shared, (0,))
    made_of = (
        a + b,
        a - b,
        a * b,
        a / b,
        -a,
        a + scalar,
        scalar - a,
        a * scalar,
        scalar / a,
        c * a,
        a - c,
        least(a, b),
        most(a, scalar),
        root(size(a)),
        size(b),
        where(a < b, a, scalar),
        where(a > scalar, b, spread(scalar, a)),
        behind(a, scalar),
        behind(a, b),
        first_of(a),
        last_of(a),
        fused(a, b, c),
        fused(a, scalar, b),
    )
    for k, value in enumerate(made_of):
        store(made, (row, k), value)


def _by_numpy(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> list[np.ndarray]:
    wide = [x.astype(np.float64) for x in (a, b, c)]
    return [
        a + b,
        a - b,
        a * b,
        a / b,
        -a,
        a + S,
        S - a,
        a * S,
        S / a,
        c * a,
        a - c,
        np.minimum(a, b),
        np.maximum(a, S),
        np.sqrt(np.abs(a)),
        np.abs(b),
        np.where(a < b, a, S),
        np.where(a > S, b, S),
        np.append(S, a[:-1]),
        np.append(b[0], a[:-1]),
        np.full(LANES, a[0]),
        np.full(LANES, a[-1]),
        wide[0] * wide[1] + wide[2],  # a product of two float32 is exact in float64
        wide[0] * np.float64(S) + wide[1],
    ]


@pytest.mark.parametrize("rows", [(0, 1), ((0, 1),)], ids=["one by one", "as a pair"])
def test_every_operation_is_numpys_to_the_last_bit(rows) -> None:
    made = np.empty((2, 23, LANES), np.float32)
    for row in rows:
        _all(row, GIVEN, SHARED, S, made)
    for given, found in zip(GIVEN, made, strict=True):
        for ours, theirs in zip(found, _by_numpy(*given, SHARED[0]), strict=True):
            assert np.array_equal(ours, theirs.astype(np.float32))


@exact()
def _below(row, given, bound):  # type: ignore[no-untyped-def]
    return is_any(load(given, (row, 0)) < number(bound, (row,)))


@pytest.mark.parametrize("row", [0, (0, 1), (1, 0)], ids=str)
@pytest.mark.parametrize("lane", range(LANES))
def test_one_of_all_is_found(lane: int, row) -> None:
    given, bound = np.ones((2, 1, LANES), np.float32), np.array([0, -2], np.float32)
    assert not _below(row, given, bound)
    given[0, 0, lane] = -1
    assert _below(row, given, bound)
    given[0, 0, lane] = np.nan  # cannot be compared
    assert not _below(row, given, bound)


@exact()
def _turned_over(given, made):  # type: ignore[no-untyped-def]
    a, b, c, d = load(given, (0,)), load(given, (1,)), load(given, (2,)), load(given, (3,))
    e, f, g, h = load(given, (4,)), load(given, (5,)), load(given, (6,)), load(given, (7,))
    for k, value in enumerate(transposed((a, b, c, d, e, f, g, h))):
        store(made, (k,), value)


def test_eight_octets_are_turned_over() -> None:
    given = RNG.standard_normal((LANES, LANES)).astype(np.float32)
    made = np.empty_like(given)
    _turned_over(given, made)
    assert np.array_equal(made, given.T)


@exact()
def _mixed(given, made):  # type: ignore[no-untyped-def]
    store(made, (0, 0), load(given, ((0, 1), 0)))


def test_a_pair_is_not_stored_as_one() -> None:
    with pytest.raises(TypingError, match="store"):
        _mixed(GIVEN, GIVEN.copy())
