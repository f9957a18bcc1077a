from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from echoavatar.nn import StreamState


@dataclass
class Inner(StreamState):
    count: Tensor


@dataclass
class Outer(StreamState):
    inner: Inner
    rings: list[Inner]
    last: Tensor


def filled() -> Outer:
    return Outer(Inner(torch.ones(3, 2)), [Inner(torch.full((3,), 2.0)), Inner(torch.full((3,), 3.0))], torch.ones(3))


def test_reset_zeroes_the_chosen_rows_of_every_tensor_nested_ones_included() -> None:
    state = filled()
    state.reset(torch.tensor([False, True, False]))
    assert all(not tensor[1].any() and tensor[0].all() and tensor[2].all() for tensor in state.tensors())
    assert len(list(state.tensors())) == 4


def test_restore_brings_back_only_the_chosen_rows() -> None:
    state = filled()
    saved = state.snapshot()
    for tensor in state.tensors():
        tensor.zero_()
    state.restore(saved, torch.tensor([True, False, False]))
    assert torch.equal(state.last, torch.tensor([1.0, 0.0, 0.0]))
    assert torch.equal(state.rings[1].count, torch.tensor([3.0, 0.0, 0.0]))


def test_rows_are_views_of_the_whole_states_rows() -> None:
    state = filled()
    part = state.rows(slice(1, 2))
    assert [len(tensor) for tensor in part.tensors()] == [1, 1, 1, 1]
    for tensor in part.tensors():
        tensor.fill_(9)
    assert all(tensor[1].eq(9).all() and not tensor[[0, 2]].eq(9).any() for tensor in state.tensors())
    assert isinstance(part, Outer)
    assert isinstance(part.rings[0], Inner)


@dataclass
class Arrays(StreamState):
    shown: np.ndarray


def test_an_array_is_a_tensor_in_its_own_memory() -> None:
    state = Arrays(np.ones((2, 3), np.float32))
    saved = state.snapshot()
    state.reset(torch.tensor([True, False]))
    assert state.shown.tolist() == [[0, 0, 0], [1, 1, 1]]
    state.rows(slice(1, 2)).shown[:] = 4
    assert state.shown[1].tolist() == [4, 4, 4]
    state.restore(saved, torch.tensor([False, True]))
    assert state.shown.tolist() == [[0, 0, 0], [1, 1, 1]]
