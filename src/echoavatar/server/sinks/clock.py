"""A clock that follows another clock smoothly.

The playback position arrives in jumps: from a player's reports, or from a loop that was delayed. This clock runs on its
own and is corrected towards the reported position by running a little faster or slower, so that motion neither
stutters nor drifts. It stops when the other clock stops, and never runs backwards except in a jump.
"""

from echoavatar.timing import SAMPLE_RATE_HZ

CORRECTION_S = 0.1  # an error this large doubles the clock's speed, or stops the clock
JUMP_S = 0.35  # a larger error is corrected at once
EXTRAPOLATION_S = 0.1  # a report is extrapolated for this long; after that the other clock is taken to have stopped


class FollowingClock:
    """Follows a session's clock; readings are in samples."""

    def __init__(self) -> None:
        self._told: tuple[float, float] | None = None  # sample, and the time of the report
        self._read: tuple[float, float] | None = None

    def tell(self, at: float, now: float) -> None:
        """Report that the other clock shows `at` at the time `now`, in seconds of `time.monotonic`."""
        self._told = at, now

    def jump(self) -> None:
        """Take over the next report directly, without smoothing."""
        self._read = None

    def read(self, now: float) -> float | None:
        """The sample to show now; None before the first report."""
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
