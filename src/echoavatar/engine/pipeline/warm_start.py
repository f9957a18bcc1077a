"""What a session's row holds when it opens: a body that stands, made once and copied. Not in the paper.

A generator that has heard nothing and done nothing may as well be in mid-dance, and speech takes seconds to calm it. So
a session begins as one that has heard silence for a while (`Runtime.lead_in_s`). To hear it out would cost every new
session that time; here one row hears it, once for all sessions of a pipeline. What it remembers depends on the bundle
alone, so a session's motion still follows from its own sound and seed.
"""

import threading
from collections.abc import Callable
from typing import Generic

from jaxtyping import Bool
from torch import Tensor

from echoavatar.nn import StreamState
from echoavatar.nn.stream import StateT


class WarmStart(Generic[StateT]):
    """The state of one row, made by `make` when it is first needed; any thread may be the first."""

    def __init__(self, make: Callable[[], StateT]) -> None:
        self._make, self._lock = make, threading.Lock()
        self._made: StateT | None = None

    def state(self) -> StateT:
        """One row, to be copied and not changed. `Pipeline.warm_up` has it made, so that no session waits for it."""
        with self._lock:
            self._made = self._made or self._make()
            return self._made


def copy_row(state: StreamState, rows: Bool[Tensor, " b"], beginning: StreamState) -> None:
    """Copy one row's state into the chosen rows, whatever they held."""
    for tensor, kept in zip(state.tensors(), beginning.tensors(), strict=True):
        tensor[rows] = kept
