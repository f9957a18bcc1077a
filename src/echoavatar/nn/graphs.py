"""A step captured once as a CUDA graph and replayed; on other devices the same function called plainly.

A step of a large model at batch one is thousands of small kernels, and starting them one by one costs more than
running them. What is captured must not look at values on the host and must keep its shapes. The plain call is the
twin by which tests without a GPU check everything but the capture itself.
"""

from collections.abc import Callable
from typing import TypeVar

import torch
from torch import Tensor

from .stream import StreamState

WARM_UP = 3
OutputT = TypeVar("OutputT")


class Graphed:
    """`function(*inputs)` of fixed shapes; `state`, which it changes in place, is put back after warming up."""

    def __init__(
        self, function: Callable[..., Tensor], *inputs: Tensor, state: StreamState | None = None
    ) -> None:
        self._function = function
        self._inputs = [value.clone() for value in inputs]
        self._graph: torch.cuda.CUDAGraph | None = None
        self._output: Tensor | None = None
        if self._inputs[0].device.type == "cuda":
            self._capture(state)

    @property
    def is_captured(self) -> bool:
        """Whether a graph is replayed."""
        return self._graph is not None

    def __call__(self, *inputs: Tensor) -> Tensor:
        """The function's answer; on CUDA the next call overwrites it."""
        for own, value in zip(self._inputs, inputs, strict=True):
            own.copy_(value, non_blocking=True)
        if self._graph is None:
            return self._function(*self._inputs)
        self._graph.replay()
        assert self._output is not None
        return self._output

    def _capture(self, state: StreamState | None) -> None:
        before = state.snapshot() if state is not None else []
        stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(WARM_UP):
                self._function(*self._inputs)
        torch.cuda.current_stream().wait_stream(stream)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self._graph):
            self._output = self._function(*self._inputs)
        if state is not None:
            for tensor, saved in zip(state.tensors(), before, strict=True):
                tensor.copy_(saved)
