from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from echoavatar.engine.pipeline.undo import SMALL, changes, undo
from echoavatar.nn import StreamState


@dataclass
class State(StreamState):
    ring: np.ndarray
    count: np.ndarray
    flag: np.ndarray


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 9)), min_size=1, max_size=8))
def test_undoing_steps_latest_first_gives_every_earlier_state_to_the_bit(steps: list[tuple[int, int]]) -> None:
    """Two rows; a step writes a tenth of a large ring (or all of it), a count and a flag, not-a-number included."""
    state = State(np.zeros((2, 10, SMALL // 5), np.float32), np.zeros(2, np.int64), np.zeros(2, np.bool_))
    state.ring[:, 3] = -0.0
    kept = []
    for row, slot in steps:
        before = deepcopy(state)
        state.ring[row, slot] = np.nan if slot == 7 else float(len(kept) - 2)
        state.ring[row, : slot * (slot > 8)] = 5
        state.count[row] += 1
        state.flag[row] = slot % 2 == 0
        kept.append((row, before, changes(zip(before.arrays(), state.arrays(), strict=True), row, row)))
    for row, before, patches in reversed(kept):
        undo(patches, state, row)
        for old, new in zip(before.arrays(), state.arrays(), strict=True):
            assert old.tobytes() == new.tobytes()


def test_what_is_kept_is_what_changed_not_the_row() -> None:
    state = State(np.zeros((1, 10, SMALL)), np.zeros(1), np.zeros(1))
    before = deepcopy(state)
    state.ring[0, 4] = 1
    assert (
        sum(patch.values.size for patch in changes(zip(before.arrays(), state.arrays(), strict=True), 0, 0))
        == SMALL + 2
    )
