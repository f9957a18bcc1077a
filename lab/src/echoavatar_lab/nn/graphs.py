"""Steps captured as CUDA graphs and replayed; on other devices the same function is called plainly.

A step of a large model at batch one is thousands of small kernels, and starting them one by one takes longer than
running them. A captured function must not look at values on the host, must not copy to or from the host, and must keep
its shapes. Capturing needs CUDA; `capture` may be replaced, so that everything else is tested without it.
"""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from types import MethodType
from typing import Generic, TypeVar
from weakref import WeakMethod

import torch
from torch import Tensor

WARM_UP = 3
KEPT = 4  # graphs of one function; each keeps its memory
StateT = TypeVar("StateT")
AnswerT = TypeVar("AnswerT")
Capture = Callable[[Callable[[], Tensor]], Callable[[], Tensor]]
"""Makes a replay of a function without arguments; the replay's answer may be overwritten by the next replay."""


def capture_cuda(run: Callable[[], AnswerT]) -> Callable[[], AnswerT]:
    """A CUDA graph of `run`, which is called some times before, as capturing demands."""
    stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(WARM_UP):
            run()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        output = run()

    def replay() -> AnswerT:
        graph.replay()
        return output

    return replay


class GraphCache(Generic[StateT]):
    """`function(state, fixed, *inputs)`, captured once for each state, `fixed` value and set of input shapes.

    The function changes the state's tensors in place, so a graph belongs to one state; the cache keeps that state
    alive as long as the graph. The least recently used graph makes room for a new one.
    """

    def __init__(
        self,
        function: Callable[..., Tensor],
        tensors_of: Callable[[StateT], Sequence[Tensor]],
        *,
        capture: Capture | None = None,
    ) -> None:
        """Without `capture`: `capture_cuda` for inputs on a CUDA device, plain calls elsewhere.

        A method is held weakly: the object that it belongs to holds this cache, and would stay in memory, with its
        weights, until Python looks for cycles.
        """
        self._function = WeakMethod(function) if isinstance(function, MethodType) else lambda: function
        self._tensors_of, self._capture = tensors_of, capture
        self._graphs = OrderedDict[Hashable, _Graph[StateT]]()

    def __call__(self, state: StateT, fixed: Hashable, *inputs: Tensor) -> Tensor:
        """The function's answer."""
        capture = self._capture or (capture_cuda if inputs[0].is_cuda else None)
        if capture is None:
            return self._call(state, fixed, *inputs)
        addresses = tuple(tensor.data_ptr() for tensor in self._tensors_of(state))
        key = addresses, fixed, tuple((value.shape, value.dtype) for value in inputs)
        if key not in self._graphs:
            self._graphs[key] = self._captured(capture, state, fixed, inputs)
            if len(self._graphs) > KEPT:
                self._graphs.popitem(last=False)
        self._graphs.move_to_end(key)
        graph = self._graphs[key]
        for buffer, value in zip(graph.inputs, inputs, strict=True):
            buffer.copy_(value, non_blocking=True)
        return graph.replay().clone()

    def _call(self, *given: object) -> Tensor:
        function = self._function()
        assert function is not None, "the object whose method this is was let go"
        return function(*given)

    def _captured(self, capture: Capture, state: StateT, fixed: Hashable, inputs: Sequence[Tensor]) -> "_Graph[StateT]":
        """Capture over input buffers of its own, then put the state back to what it was."""
        tensors, buffers = self._tensors_of(state), [value.clone() for value in inputs]
        before = [tensor.clone() for tensor in tensors]
        replay = capture(lambda: self._call(state, fixed, *buffers))
        for tensor, saved in zip(tensors, before, strict=True):
            tensor.copy_(saved)
        return _Graph(state, buffers, replay)


@dataclass(frozen=True)
class _Graph(Generic[StateT]):
    state: StateT
    inputs: list[Tensor]
    replay: Callable[[], Tensor]
