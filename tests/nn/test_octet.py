"""Arithmetic of eight at once against numpy's, bit by bit."""

import numpy as np
import pytest
from numba.core.errors import TypingError

from echoavatar.nn.compiled import F
from echoavatar.nn.octet import (
    LANES,
    behind,
    blocks,
    exact,
    is_any,
    least,
    load,
    most,
    root,
    size,
    spread,
    store,
    where,
)

RNG = np.random.default_rng(0)
A, B = RNG.standard_normal((2, LANES)).astype(np.float32)


@exact()
def _all(given, scalar, made):  # type: ignore[no-untyped-def]
    a, b = load(given, (0,)), load(given, (1,))
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
        where(a < b, a, spread(scalar)),
        where(a > scalar, b, a),
        behind(a, scalar),
    )
    for k, value in enumerate(made_of):
        store(made, (k,), value)


def test_every_operation_is_numpys_to_the_last_bit() -> None:
    s = F(0.3)
    made = np.empty((16, LANES), np.float32)
    _all(np.stack([A, B]), s, made)
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
        np.where(s < A, B, A),
        np.append(s, A[:-1]),
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


def test_arrays_that_hold_no_octets_are_refused() -> None:
    with pytest.raises(TypingError, match="load"):
        _below(np.ones((1, LANES)))  # double precision
    with pytest.raises(TypingError, match="load"):
        _below(np.ones((LANES, 2), np.float32).T)  # the other way round in memory


@pytest.mark.parametrize("frames", [1, 8, 11])
def test_any_number_of_frames_becomes_whole_octets(frames: int) -> None:
    given = RNG.standard_normal((2, 3, frames)).astype(np.float32)
    cut = blocks(given)
    assert cut.shape == (-(-frames // LANES), 2, 3, LANES)
    joined = np.moveaxis(cut, 0, -2).reshape(2, 3, -1)
    assert np.array_equal(joined[..., :frames], given)
    assert np.array_equal(joined[..., frames:], given[..., -1:].repeat(joined.shape[-1] - frames, -1))
