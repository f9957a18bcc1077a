from dataclasses import dataclass

import numpy as np
import torch

from echoavatar.nn import StreamState


@dataclass
class Inner(StreamState):
    count: np.ndarray


@dataclass
class Outer(StreamState):
    inner: Inner
    rings: list[Inner]
    last: np.ndarray


def filled() -> Outer:
    return Outer(Inner(np.ones((3, 2))), [Inner(np.full(3, 2.0)), Inner(np.full(3, 3.0))], np.ones(3))


def test_reset_zeroes_the_chosen_rows_of_every_tensor_nested_ones_included() -> None:
    state = filled()
    state.reset(np.array([False, True, False]))
    assert all(not tensor[1].any() and tensor[0].all() and tensor[2].all() for tensor in state.arrays())
    assert len(list(state.arrays())) == 4


def test_rows_are_views_of_the_whole_states_rows() -> None:
    state = filled()
    part = state.rows(slice(1, 2))
    assert [len(tensor) for tensor in part.arrays()] == [1, 1, 1, 1]
    for tensor in part.arrays():
        tensor[:] = 9
    assert all((tensor[1] == 9).all() and not (tensor[[0, 2]] == 9).any() for tensor in state.arrays())
    assert isinstance(part, Outer)
    assert isinstance(part.rings[0], Inner)


def test_rows_begin_as_the_one_row_of_another_state() -> None:
    state, start = filled(), filled().rows(slice(0, 1)).mapped(lambda part: part + 5)
    state.overwrite(np.array([False, True, False]), start)
    assert state.rings[0].count.tolist() == [2, 7, 2]
    assert state.inner.count[1].tolist() == [6, 6]


def test_modules_of_torch_keep_tensors_in_it() -> None:
    state = filled().mapped(torch.from_numpy)
    state.reset(np.array([True, False, True]))
    assert state.last.tolist() == [0, 1, 0]
    state.rows(slice(1, 2)).last[:] = 4
    assert state.last.tolist() == [0, 4, 0]
