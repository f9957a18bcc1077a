"""A clock that follows another one smoothly.

What is heard is told a sink in jumps: by reports of a player, by a loop that was held up. The sink's own clock runs on
by itself and is drawn to what it was told, a little faster or slower, so that motion neither stutters nor drifts; it
never runs backwards but for a jump, and comes to rest when the other one does.
"""

from ..timing import SAMPLE_RATE_HZ

CORRECTION_S = 0.1  # an error of so much doubles the clock's speed, or stops it
JUMP_S = 0.35  # beyond it there is nothing to be smooth about
EXTRAPOLATION_S = 0.1  # what was told longer ago says only that time stands still


class FollowingClock:
    """Reads in samples of the session's clock."""

    def __init__(self) -> None:
        self._told: tuple[float, float] | None = None  # sample, when
        self._read: tuple[float, float] | None = None

    def tell(self, at: float, now: float) -> None:
        """The other clock shows `at` at the time `now`, in seconds of `time.monotonic`."""
        self._told = at, now

    def jump(self) -> None:
        """The next reading is what is told then, without smoothness."""
        self._read = None

    def read(self, now: float) -> float | None:
        """The sample to be shown now; None before anything was told."""
        if self._told is None:
            return None
        at, then = self._told
        goal = at + min(max(now - then, 0.0), EXTRAPOLATION_S) * SAMPLE_RATE_HZ
        if self._read is None or abs(goal - self._read[0]) > JUMP_S * SAMPLE_RATE_HZ:
            self._read = goal, now
            return goal
        mine, before = self._read
        passed = max(0.0, now - before) * SAMPLE_RATE_HZ
        error = (goal - (mine + passed)) / (CORRECTION_S * SAMPLE_RATE_HZ)
        mine += passed * min(max(1 + error, 0.0), 2.0)
        self._read = mine, now
        return mine
