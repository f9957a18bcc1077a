from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from echoavatar.engine.pipeline.undo import Rows
from echoavatar.nn import StreamState

SLOT = 800


@dataclass
class State(StreamState):
    ring: np.ndarray
    count: np.ndarray
    flag: np.ndarray
    tensor: torch.Tensor


def rows() -> Rows:
    arrays = np.zeros((2, 10, SLOT), np.float32), np.zeros((2, 3), np.float32), np.zeros(2, np.bool_)
    return Rows(State(*arrays, torch.zeros(2, 5)))


def content(state: StreamState) -> list[bytes]:
    return [np.asarray(part).tobytes() for part in state.arrays()]


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 9)), min_size=1, max_size=8))
def test_undoing_steps_latest_first_gives_every_earlier_state_to_the_bit(steps: list[tuple[int, int]]) -> None:
    """Two rows; a step writes a tenth of a ring (or all of it), a count, a flag and a tensor; NaN and -0 included."""
    whole = rows()
    whole.state.ring[:, 3] = -0.0
    kept = []
    for row, slot in steps:
        old, before = deepcopy(whole.state), whole.kept(row)
        state = whole.of([row])
        state.ring[0, slot] = np.nan if slot == 7 else float(len(kept) - 2)
        state.ring[0, : slot * (slot > 8)] = 5
        state.count += 1
        state.flag[:] = slot % 2 == 0
        state.tensor += 1
        kept.append((row, old, whole.changes(row, before)))
    for row, old, patch in reversed(kept):
        whole.undo(row, patch)
        assert content(whole.state) == content(old)


def test_what_is_kept_is_what_changed_not_the_row() -> None:
    whole = rows()
    before = whole.kept(0)
    whole.of([0]).ring[0, 4] = 1
    assert 8 * whole.changes(0, before).words.size == whole.state.ring[0, 4].nbytes


def test_a_step_on_several_rows_counts_once_it_is_put_back() -> None:
    whole = rows()
    state, before = whole.of([1, 0]), content(whole.state)
    state.ring[0], state.count[1], state.tensor[0] = 2, 3, 4
    assert all(part.flags.c_contiguous for part in (state.ring, whole.of([1]).ring)), "loops are compiled for these"
    assert content(whole.state) == before
    whole.put([1, 0], state)
    assert whole.state.ring.mean((1, 2)).tolist() == [0, 2]
    assert whole.state.count.tolist() == [[3] * 3, [0] * 3]
    assert whole.state.tensor.mean(1).tolist() == [0, 4]
