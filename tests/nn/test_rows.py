"""Where octets stand: in one row's places, in two rows' at once, anywhere in an array."""

import numpy as np
import pytest
from numba.core.errors import TypingError

from echoavatar.nn.octet import LANES, exact
from echoavatar.nn.rows import ALONE, IN_PAIRS, blocks, desk, following, load, number, sessions, store

RNG = np.random.default_rng(0)


@exact()
def _middle(row, given, made):  # type: ignore[no-untyped-def]
    total = load(given, (row, 1))
    total += load(given, (row, 0))
    store(made, (row, 0), total)


@pytest.mark.parametrize("row", [2, (2, 0)], ids=str)
def test_places_are_those_of_the_array(row) -> None:
    given = RNG.standard_normal((3, 2, LANES)).astype(np.float32)
    made = np.zeros((3, 1, LANES), np.float32)
    _middle(row, given, made)
    rows = sessions(row)
    for at in range(3):
        assert np.array_equal(made[at, 0], given[at].sum(0) if at in rows else np.zeros(LANES))


@exact()
def _from_there(given, at, made):  # type: ignore[no-untyped-def]
    store(made, (at,), load(given, (1, at)))


def test_an_index_for_every_axis_is_where_eight_numbers_begin() -> None:
    given, made = np.arange(40, dtype=np.float32).reshape(2, 20), np.zeros(20, np.float32)
    _from_there(given, 5, made)
    assert made.tolist() == [0] * 5 + list(range(25, 33)) + [0] * 7


@exact()
def _all_rows(row, given, shares, made, seen):  # type: ignore[no-untyped-def]
    """Twice through scratch memory; every session is seen once."""
    spare = np.empty((2, 1, LANES), np.float32)
    for _ in range(given.shape[0] // len(sessions(row))):
        store(spare, (desk(row), 0), load(given, (row, 0)) * number(shares, (row,)))
        store(made, (row, 0), load(spare, (desk(row), 0)))
        for own, session in enumerate(sessions(row)):
            seen[session] += 1 + spare[own, 0, 0]
        row = following(row)


@pytest.mark.parametrize("start", [ALONE, IN_PAIRS], ids=str)
def test_a_loop_goes_through_all_rows(start) -> None:
    given = RNG.standard_normal((6, 1, LANES)).astype(np.float32)
    shares, made, seen = np.arange(6, dtype=np.float32), np.empty_like(given), np.zeros(6, np.float32)
    _all_rows(start, given, shares, made, seen)
    assert np.array_equal(made, given * shares[:, None, None])
    assert np.array_equal(seen, 1 + made[:, 0, 0])


def test_rows_outside_compiled_loops_are_the_same() -> None:
    assert (sessions(3), desk(3), following(3)) == ((3,), 0, 4)
    assert (sessions((2, 3)), desk((2, 3)), following((2, 3))) == ((2, 3), (0, 1), (4, 5))


def test_arrays_that_hold_no_octets_are_refused() -> None:
    made = np.zeros((1, 1, LANES), np.float32)
    with pytest.raises(TypingError, match="load"):
        _middle(0, np.ones((1, 2, LANES)), made)  # double precision
    with pytest.raises(TypingError, match="load"):
        _middle(0, np.ones((LANES, 2, 1), np.float32).T, made)  # the other way round in memory


@pytest.mark.parametrize("frames", [1, 8, 11])
def test_any_number_of_frames_becomes_whole_octets(frames: int) -> None:
    given = RNG.standard_normal((2, 3, frames)).astype(np.float32)
    cut = blocks(given)
    assert cut.shape == (-(-frames // LANES), 2, 3, LANES)
    joined = np.moveaxis(cut, 0, -2).reshape(2, 3, -1)
    assert np.array_equal(joined[..., :frames], given)
    assert np.array_equal(joined[..., frames:], given[..., -1:].repeat(joined.shape[-1] - frames, -1))
