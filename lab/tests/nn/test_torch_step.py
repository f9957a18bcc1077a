"""A module's step takes and gives arrays; its state stays as tensors."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from echoavatar.nn import StreamState
from echoavatar_lab.nn.torch_step import TorchStep


@dataclass
class Sum(StreamState):
    total: Tensor


def add(x: Tensor, state: Sum, active: Tensor) -> Tensor:
    state.total += torch.where(active, x, 0)
    return state.total.clone()


def test_a_step_hears_and_tells_arrays() -> None:
    step = TorchStep(add, lambda rows: Sum(torch.zeros(rows)), "cpu")
    state, everyone = step.init_state(2), np.ones(2, np.bool_)
    step.step(np.float32([1, 2]), state, everyone)
    told = step.step(np.float32([3, 4]), state, np.array([True, False]))
    assert isinstance(told, np.ndarray)
    assert told.tolist() == [4, 2]
