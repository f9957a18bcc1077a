"""The five laws of the streaming contract, for any module: call `hold(...)` from a test.

A stream is anything with `init_state(rows)`, `step(x, state, active)` and a call for the whole clip. The laws compare a
module with itself; every module needs an outside witness besides.
"""

from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
import torch


def hold(
    stream: Any,
    make: Callable[[int, int, torch.Generator], torch.Tensor],
    *,
    unit: int = 1,
    cuts: Sequence[Sequence[int]] = ((1, 1, 1, 1, 1, 1, 1, 1), (3, 1, 4), (2, 6), (7, 1)),
    atol: float = 1e-9,
) -> None:
    """Assert all five laws. `make(rows, frames, generator)` draws input; `unit` frames are the smallest step."""
    generator = torch.Generator().manual_seed(0)
    for parts in cuts:
        any_chunking_gives_the_offline_answer(stream, make(3, unit * sum(parts), generator), unit, parts, atol)
    future_does_not_leak(stream, make(2, unit * 12, generator), make(2, unit * 12, generator), unit, atol)
    idle_rows_are_bit_identical(stream, make(3, unit * 6, generator), unit)
    reset_rows_equal_new_ones(stream, make(3, unit * 6, generator), unit, atol)
    a_neighbour_changes_nothing(stream, make(2, unit * 6, generator), make(2, unit * 6, generator), unit, atol)


def run(
    stream: Any, x: torch.Tensor, state: Any, sizes: Sequence[int], active: torch.Tensor | None = None
) -> torch.Tensor:
    active = torch.ones(x.shape[0], dtype=torch.bool) if active is None else active
    return torch.cat([stream.step(part, state, active) for part in x.split(list(sizes), 1)], 1)


def any_chunking_gives_the_offline_answer(
    stream: Any, x: torch.Tensor, unit: int, parts: Sequence[int], atol: float
) -> None:
    streamed = run(stream, x, stream.init_state(x.shape[0]), [unit * size for size in parts])
    torch.testing.assert_close(streamed, stream(x), atol=atol, rtol=0)


def future_does_not_leak(stream: Any, x: torch.Tensor, other: torch.Tensor, unit: int, atol: float) -> None:
    cut = 7 * unit
    changed = torch.cat([x[:, :cut], other[:, cut:]], 1)
    whole, new = stream(x), stream(changed)
    known = whole.shape[1] * cut // x.shape[1]
    torch.testing.assert_close(whole[:, :known], new[:, :known], atol=atol, rtol=0)
    assert not torch.equal(whole[:, known:], new[:, known:])


def idle_rows_are_bit_identical(stream: Any, x: torch.Tensor, unit: int) -> None:
    state = stream.init_state(3)
    run(stream, x[:, : 3 * unit], state, [3 * unit])
    before = deepcopy(state)
    run(stream, x[:, 3 * unit :], state, [3 * unit], torch.tensor([True, False, True]))
    for old, new in zip(before.arrays(), state.arrays(), strict=True):
        assert np.array_equal(old[1], new[1])
    assert any(not np.array_equal(old[0], new[0]) for old, new in zip(before.arrays(), state.arrays(), strict=True))


def reset_rows_equal_new_ones(stream: Any, x: torch.Tensor, unit: int, atol: float) -> None:
    state = stream.init_state(3)
    run(stream, x, state, [6 * unit])
    state.reset(np.array([False, True, False]))
    again = run(stream, x, state, [2 * unit] * 3)
    fresh = run(stream, x, stream.init_state(3), [2 * unit] * 3)
    torch.testing.assert_close(again[1], fresh[1], atol=atol, rtol=0)
    assert not torch.equal(again[0], fresh[0])


def a_neighbour_changes_nothing(stream: Any, x: torch.Tensor, other: torch.Tensor, unit: int, atol: float) -> None:
    both = torch.cat([x[:1], other[1:]])
    one = run(stream, x, stream.init_state(2), [unit] * 6)
    two = run(stream, both, stream.init_state(2), [unit] * 6)
    torch.testing.assert_close(one[0], two[0], atol=atol, rtol=0)
    assert not torch.equal(one[1], two[1])
