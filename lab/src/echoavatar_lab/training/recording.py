"""The forward and backward pass of a step, recorded once as a CUDA graph and replayed.

A small model's step is a thousand short kernels, and a GPU waits for Python to start each. A replay starts all at once.
It repeats the same kernels on the same memory, so a task must allow it (`TrainingTask.is_recordable`).
"""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from echoavatar.nn.graphs import capture_cuda

from .task import take_rows, tensors_in

Values = Mapping[str, Tensor | float]


class Recording:
    """A function of a batch, recorded at its first call."""

    def __init__(
        self,
        run: Callable[[Any], Values],
        device: torch.device,
        *,
        capture: Callable[[Callable[[], Values]], Callable[[], Values]] = capture_cuda,
    ) -> None:
        """`run` queues the kernels of a pass and returns values; it must write into new gradients."""
        self._run, self._device, self._capture = run, device, capture
        self._batch: Any = None
        self._replay: Callable[[], Values] | None = None

    def __call__(self, batch: Any) -> Values:
        """The values for a batch on the CPU; they and the gradients are valid until the next call.

        Raises:
            RuntimeError: the batch has other shapes than the first.
        """
        if self._replay is None:
            self._batch = take_rows(batch, slice(None), self._device)
            self._replay = self._capture(lambda: self._run(self._batch))
        sent = take_rows(batch, slice(None), self._device)
        for own, new in zip(tensors_in(self._batch), tensors_in(sent), strict=True):
            own.copy_(new)
        return self._replay()
