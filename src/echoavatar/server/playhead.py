"""An estimate of the player's place: its last report, and the wall clock since."""

from echoavatar.timing import SAMPLE_RATE_HZ

PATIENCE_S = 1.0  # after a report; a player that is silent for longer is not assumed to play on


class Playhead:
    """An estimate of the first sample that was not heard. It waits at the end of what was sent."""

    def __init__(self) -> None:
        self._at = 0.0
        self._now: float | None = None
        self._reported: float | None = None  # when

    @property
    def sample(self) -> int:
        """The estimate."""
        return round(self._at)

    def advance(self, now: float, end: int) -> None:
        """Advance by the wall clock; motion up to `end` was sent."""
        until = now if self._reported is None else min(now, self._reported + PATIENCE_S)
        if self._now is not None and until > self._now:
            self._at = max(self._at, min(self._at + (until - self._now) * SAMPLE_RATE_HZ, end))
        self._now = now

    def report(self, at: int, now: float, end: int) -> None:
        """Take the player's report of its place."""
        self._at, self._now, self._reported = float(min(at, end)), now, now

    def jump(self, at: int) -> None:
        """Everything after `at` was taken back, and the player stands there."""
        self._at = float(at)

    def pause(self) -> None:
        """No client plays; the next player begins here."""
        self._now = self._reported = None
