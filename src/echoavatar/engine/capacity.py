"""How many live sessions a machine carries in real time, from what the last chunks cost.

No constant could say so, nor a measurement at the start alone: video, voices and other programs need the machine, too.
"""

from collections import deque
from statistics import fmean

FULL = 0.7  # of the workers' time: what sessions may take, since chunks that come together wait for each other
RECENT = 64  # chunks


class Capacity:
    """The cost of the last chunks, and how many sessions the workers can make them for."""

    def __init__(self, workers: int, chunk_seconds: float) -> None:
        self._supply = FULL * workers * chunk_seconds  # seconds of workers in the time of a chunk
        self._costs: deque[float] = deque(maxlen=RECENT)  # in seconds of a worker

    def note(self, seconds: float, chunks: int) -> None:
        """A worker made so many chunks, as one batch."""
        self._costs.extend([seconds / chunks] * chunks)

    def forget(self) -> None:
        """What was noted does not count."""
        self._costs.clear()

    def room(self, most: int) -> int:
        """How many sessions there may be: at least one, and `most` where they cost less or nothing was noted."""
        demand = most * fmean(self._costs) if self._costs else 0.0
        return most if demand <= self._supply else max(1, int(most * self._supply / demand))
