"""Sixteen numbers at once against numpy's and against the loops that take them one by one."""

import numpy as np
import pytest
from numba.core.errors import TypingError

from echoavatar.nn.compiled import compiled, exponential, gelu
from echoavatar.nn.wide import (
    WIDE,
    exponentials,
    gelus,
    highest,
    narrowed,
    put,
    total,
    wide,
    widened,
    with_product,
)

RNG = np.random.default_rng(0)


@compiled()
def _rows(given, share, made):  # type: ignore[no-untyped-def]
    a, b = wide(given, (0, 3)), wide(given, (1, 0))
    put(made, (0, 0), with_product(a, share, b))
    put(made, (1, 0), exponentials(a * share))
    put(made, (2, 0), gelus(a * share))
    made[3, 0], made[3, 1] = total(a), highest(a)


@compiled()
def _one_by_one(given, made):  # type: ignore[no-untyped-def]
    for i in range(given.shape[0]):
        made[0, i], made[1, i] = exponential(given[i]), gelu(given[i])


@pytest.mark.parametrize("share", [0.7, 40.0])
def test_sixteen_are_as_one_by_one(share: float) -> None:
    given = RNG.standard_normal((2, WIDE + 3)).astype(np.float32)
    made, single = np.empty((4, WIDE), np.float32), np.empty((2, WIDE), np.float32)
    _rows(given, np.float32(share), made)
    a, b = given[0, 3:], given[1, :WIDE]
    scaled = a * np.float32(share)
    _one_by_one(scaled, single)
    np.testing.assert_allclose(made[0], a + share * b, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(made[1], single[0], rtol=1e-6)
    np.testing.assert_allclose(made[2], single[1], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(made[3, 0], a.sum(), rtol=1e-5)
    assert made[3, 1] == a.max()


def test_exponentials_and_gates_are_the_functions_they_are_called() -> None:
    given = np.stack([np.linspace(-80, 80, WIDE + 3), np.linspace(-6, 6, WIDE + 3)]).astype(np.float32)
    made = np.empty((4, WIDE), np.float32)
    _rows(given, np.float32(1), made)
    np.testing.assert_allclose(made[1], np.exp(given[0, 3:].astype(float)), rtol=4e-6)
    _rows(given[::-1].copy(), np.float32(1), made)
    x = given[1, 3:].astype(float)
    from scipy.special import erf

    np.testing.assert_allclose(made[2], x * (1 + erf(x / np.sqrt(2))) / 2, atol=2e-6)


def test_gates_far_below_nothing_are_nothing() -> None:
    """Not numbers too small to be normal, with which a processor takes a hundred times as long."""
    made = np.empty((4, WIDE), np.float32)
    _rows(np.full((2, WIDE + 3), -12.5, np.float32), np.float32(1), made)
    assert not made[2].any()


@compiled()
def _as_halves(numbers, halves, back, made):  # type: ignore[no-untyped-def]
    for i in range(numbers.shape[0]):
        halves[i] = narrowed(numbers[i])
        back[i] = widened(halves[i])
    put(made, (0,), wide(halves, (1,)))


def test_halves_are_numpys() -> None:
    numbers = np.concatenate([RNG.standard_normal(WIDE - 3), [7e4, -1e-7, 0.1, 65504]]).astype(np.float32)
    halves, back, made = (
        np.empty(WIDE + 1, np.uint16),
        np.empty(WIDE + 1, np.float32),
        np.empty(WIDE, np.float32),
    )
    _as_halves(numbers, halves, back, made)
    with np.errstate(over="ignore"):
        wanted = numbers.astype(np.float16)
    assert np.array_equal(halves, wanted.view(np.uint16))
    assert np.array_equal(back, wanted.astype(np.float32))
    assert np.array_equal(made, back[1:])


def test_other_numbers_are_refused() -> None:
    with pytest.raises(TypingError, match="wide"):
        _rows(np.ones((2, WIDE + 3)), np.float32(1), np.empty((4, WIDE), np.float32))
