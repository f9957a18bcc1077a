"""How many live sessions a machine carries in real time, from what the last chunks cost.

Neither a constant nor one measurement at the start can tell: video, voices and other programs need the machine, too.
"""

from collections import deque
from statistics import fmean

FULL = 0.7  # share of the workers' time that sessions may take: chunks that come together wait for each other
RECENT = 64  # chunks whose costs are averaged


class Capacity:
    """The cost of the last chunks, and how many sessions the workers can make them for."""

    def __init__(self, workers: int, chunk_seconds: float) -> None:
        self._supply = FULL * workers * chunk_seconds  # seconds of work available in the time of a chunk
        self._costs: deque[float] = deque(maxlen=RECENT)  # of chunks, in seconds of work

    def note(self, seconds: float, chunks: int) -> None:
        """Note that a worker made so many chunks in so many seconds, as one batch."""
        self._costs.extend([seconds / chunks] * chunks)

    def forget(self) -> None:
        """Drop all costs noted so far."""
        self._costs.clear()

    def room(self, most: int) -> int:
        """How many sessions the workers carry, from 1 to `most`; `most` before any cost was noted."""
        demand = most * fmean(self._costs) if self._costs else 0.0
        return most if demand <= self._supply else max(1, int(most * self._supply / demand))
