"""Where the player is, as well as the server can know: what it last said, and the wall clock since."""

from ..timing import SAMPLE_RATE_HZ

PATIENCE_S = 1.0  # a player that reports and falls silent for longer is not assumed to play on


class Playhead:
    """An estimate of the first sample that was not heard; waits where nothing is there to be played."""

    def __init__(self) -> None:
        self._at = 0.0
        self._now: float | None = None
        self._reported: float | None = None  # when

    @property
    def sample(self) -> int:
        """The estimate."""
        return round(self._at)

    def advance(self, now: float, end: int) -> None:
        """Time goes by; motion up to `end` was sent."""
        until = now if self._reported is None else min(now, self._reported + PATIENCE_S)
        if self._now is not None and until > self._now:
            self._at = max(self._at, min(self._at + (until - self._now) * SAMPLE_RATE_HZ, end))
        self._now = now

    def report(self, at: int, now: float, end: int) -> None:
        """The player says where it is."""
        self._at, self._now, self._reported = float(min(at, end)), now, now

    def jump(self, at: int) -> None:
        """What lay after `at` was taken back, and the player stands there."""
        self._at = float(at)

    def pause(self) -> None:
        """Nobody plays; the next player begins here."""
        self._now = self._reported = None
