"""The warm start of a session: the state after a stretch of silence, made once and copied. Not in the paper.

A generator without a past may begin in mid-dance, and speech takes seconds to calm it. So a session starts with the
state of one that has heard `Runtime.lead_in_s` of silence. One row computes that state, once for all sessions of a
pipeline. It depends on the bundle alone, so a session's motion still depends only on its own sound and seed.
"""

import threading
from collections.abc import Callable
from typing import Generic

from jaxtyping import Bool
from torch import Tensor

from echoavatar.nn import StreamState
from echoavatar.nn.stream import StateT


class WarmStart(Generic[StateT]):
    """The state of one row, made on first use; safe to call from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._made: StateT | None = None

    def state(self, make: Callable[[], StateT]) -> StateT:
        """The row, to be copied and not changed. `Pipeline.warm_up` makes it, so that no session waits for it."""
        with self._lock:
            self._made = self._made or make()
            return self._made


def copy_row(state: StreamState, rows: Bool[Tensor, " b"], source: StreamState) -> None:
    """Overwrite the chosen rows of `state` with the one row of `source`."""
    for tensor, row in zip(state.tensors(), source.tensors(), strict=True):
        tensor[rows] = row
