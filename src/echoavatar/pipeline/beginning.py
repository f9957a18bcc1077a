"""What a session's row holds when it opens: a body that stands, made once and copied. Not in the paper.

A generator that has heard nothing and done nothing may as well be in mid-dance, and speech takes seconds to calm it. So
a session begins as one that has heard silence for a while (`Runtime.lead_in_s`). To hear it out would cost every new
session that time; here one row hears it, once for all sessions of a pipeline. What it remembers depends on the bundle
alone, so a session's motion still follows from its own sound and seed.
"""

import threading
from collections.abc import Callable

from jaxtyping import Bool
from torch import Tensor

from ..nn import StreamState


class Beginning:
    """The state of one row, made by `make` when it is first needed; any thread may be the first."""

    def __init__(self, make: Callable[[], StreamState]) -> None:
        self._make, self._lock = make, threading.Lock()
        self._kept: list[Tensor] = []

    def prepare(self) -> None:
        """Make it now, so that no session waits for it."""
        with self._lock:
            self._kept = self._kept or self._make().snapshot()

    def write(self, state: StreamState, rows: Bool[Tensor, " b"]) -> None:
        """Begin in the chosen rows, whatever they held."""
        self.prepare()
        for tensor, kept in zip(state.tensors(), self._kept, strict=True):
            tensor[rows] = kept
