"""Arithmetic of eight at once against numpy's, bit by bit."""

import numpy as np
import pytest
from numba.core.errors import TypingError

from echoavatar.nn.compiled import F
from echoavatar.nn.octet import (
    LANES,
    ask_for,
    behind,
    blocks,
    exact,
    fused,
    is_any,
    least,
    load,
    most,
    root,
    scratch,
    size,
    spread,
    store,
    transposed,
    where,
)

RNG = np.random.default_rng(0)
A, B, C = RNG.standard_normal((3, LANES)).astype(np.float32)


@exact()
def _all(given, scalar, made):  # type: ignore[no-untyped-def]
    a, b, c = load(given, (0,)), load(given, (1,)), load(given, (2,))
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
        least(a, b),
        most(a, scalar),
        root(size(a)),
        size(b),
        where(a < b, a, scalar),
        where(a > scalar, b, spread(scalar, a)),
        behind(a, scalar),
        fused(a, b, c),
        fused(a, scalar, b),
    )
    for k, value in enumerate(made_of):
        store(made, (k,), value)


def test_every_operation_is_numpys_to_the_last_bit() -> None:
    s = F(0.3)
    made = np.empty((18, LANES), np.float32)
    _all(np.stack([A, B, C]), s, made)
    a, b, c = (x.astype(np.float64) for x in (A, B, C))
    wanted = (
        A + B,
        A - B,
        A * B,
        A / B,
        -A,
        A + s,
        s - A,
        A * s,
        s / A,
        np.minimum(A, B),
        np.maximum(A, s),
        np.sqrt(np.abs(A)),
        np.abs(B),
        np.where(A < B, A, s),
        np.where(s < A, B, s),
        np.append(s, A[:-1]),
        a * b + c,  # a product of two float32 is exact in float64
        a * np.float64(s) + b,
    )
    for ours, theirs in zip(made, wanted, strict=True):
        assert np.array_equal(ours, theirs.astype(np.float32))


@exact()
def _below(given):  # type: ignore[no-untyped-def]
    return is_any(load(given, (0,)) < F(0))


@pytest.mark.parametrize("lane", range(LANES))
def test_one_of_eight_is_found(lane: int) -> None:
    given = np.ones((1, LANES), np.float32)
    assert not _below(given)
    given[0, lane] = -1
    assert _below(given)
    given[0, lane] = np.nan  # cannot be compared
    assert not _below(given)


@exact()
def _middle(given, made, row):  # type: ignore[no-untyped-def]
    total = load(given, (row, 1))
    total += load(given, (row, 0))
    store(made, (row, 0), total)


def test_places_are_those_of_the_array() -> None:
    given = RNG.standard_normal((3, 2, LANES)).astype(np.float32)
    made = np.zeros((3, 1, LANES), np.float32)
    _middle(given, made, 2)
    assert not made[:2].any()
    assert np.array_equal(made[2, 0], given[2, 0] + given[2, 1])


@exact()
def _from_there(given, at, made):  # type: ignore[no-untyped-def]
    store(made, (at,), load(given, (1, at)))


def test_an_index_for_every_axis_is_where_eight_numbers_begin() -> None:
    given, made = np.arange(40, dtype=np.float32).reshape(2, 20), np.zeros(20, np.float32)
    _from_there(given, 5, made)
    assert made.tolist() == [0] * 5 + list(range(25, 33)) + [0] * 7


def test_arrays_that_hold_no_octets_are_refused() -> None:
    with pytest.raises(TypingError, match="load"):
        _below(np.ones((1, LANES)))  # double precision
    with pytest.raises(TypingError, match="load"):
        _below(np.ones((LANES, 2), np.float32).T)  # the other way round in memory


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


@pytest.mark.parametrize("frames", [1, 8, 11])
def test_any_number_of_frames_becomes_whole_octets(frames: int) -> None:
    given = RNG.standard_normal((2, 3, frames)).astype(np.float32)
    cut = blocks(given)
    assert cut.shape == (-(-frames // LANES), 2, 3, LANES)
    joined = np.moveaxis(cut, 0, -2).reshape(2, 3, -1)
    assert np.array_equal(joined[..., :frames], given)
    assert np.array_equal(joined[..., frames:], given[..., -1:].repeat(joined.shape[-1] - frames, -1))


@exact()
def _through_scratch(x, y):  # type: ignore[no-untyped-def]
    spare = scratch((x.shape[0], 2, LANES))
    for row in range(x.shape[0]):
        store(spare, (row, 1), load(x, (row,)))
        store(spare, (row, 0), -load(x, (row,)))
    for row in range(x.shape[0]):
        for frame in range(LANES):
            y[row, frame] = spare[row, 1, frame] - spare[row, 0, frame]


def test_an_array_on_the_stack_keeps_what_is_written_by_octet_and_by_number() -> None:
    x = np.random.default_rng(0).standard_normal((40, LANES)).astype(np.float32)
    y = np.empty_like(x)
    _through_scratch(x, y)
    np.testing.assert_array_equal(y, 2 * x)


@exact()
def _asking(x, y):  # type: ignore[no-untyped-def]
    for row in range(x.shape[0]):
        ask_for(x, (row,), x.shape[1])
        ask_for(x, (row, 3), 1 << 40)
        store(y, (row,), load(x, (row,)))


def test_memory_may_be_asked_for_wherever_it_is_or_is_not() -> None:
    x = np.random.default_rng(0).standard_normal((4, LANES)).astype(np.float32)
    y = np.empty_like(x)
    _asking(x, y)
    np.testing.assert_array_equal(y, x)
    asked = _asking.inspect_llvm(_asking.signatures[0])
    assert "llvm.prefetch" in asked


def test_only_arrays_without_gaps_can_be_asked_for() -> None:
    x = np.zeros((4, LANES), np.float32)
    with pytest.raises(TypingError):
        _asking(np.asfortranarray(x), x)
