"""The pace of a live session: where its player is, and when its next chunk must be on the clock.

The engine makes a chunk of a paced session only after it was scheduled: speech up to `ahead_seconds` ahead of playback,
silence just in time, so that speech is answered soon. Nothing here waits: the owner calls `schedule` after each event
of the session, and again at the deadline that `deadline` names.
"""

import math

from echoavatar.timing import SAMPLE_RATE_HZ

from .session_core import SessionCore

PATIENCE_S = 1.0  # a player that has not reported for longer is not assumed to play on
MARGIN_S = 0.15  # allowance for the network, beside the engine's own time


class Playhead:
    """An estimate of the first sample that was not heard: the player's last report, and the wall clock since.

    The playhead waits at the end of the motion sent. Times are seconds of any monotonic clock.
    """

    def __init__(self) -> None:
        self._at = 0.0
        self._now: float | None = None
        self._reported: float | None = None  # when the player last reported

    @property
    def sample(self) -> int:
        """The sample that the player is estimated to have reached."""
        return round(self._at)

    def advance(self, now: float, end: int) -> None:
        """Advance by the wall clock; motion up to `end` was sent."""
        until = now if self._reported is None else min(now, self._reported + PATIENCE_S)
        if self._now is not None and until > self._now:
            self._at = max(self._at, min(self._at + (until - self._now) * SAMPLE_RATE_HZ, end))
        self._now = now

    def reaches(self, sample: int, now: float, end: int) -> float | None:
        """When the playhead will reach a sample; None if it waits before that, for motion or for a report."""
        at = now + max(0.0, sample - self._at) / SAMPLE_RATE_HZ
        return at if sample <= self.waits_at(end) else None

    def waits_at(self, end: int) -> int:
        """The sample at which the playhead will wait for motion or a report; its present one if no client plays."""
        if self._now is None:
            return self.sample
        patience = math.inf if self._reported is None else self._reported + PATIENCE_S - self._now
        return round(min(max(self._at, end), self._at + max(0.0, patience) * SAMPLE_RATE_HZ))

    def report(self, at: int, now: float, end: int) -> None:
        """Take the player's report of its place."""
        self._at, self._now, self._reported = float(min(at, end)), now, now

    def jump(self, at: int) -> None:
        """Everything after `at` was taken back, and the player stands there."""
        self._at = float(at)

    def pause(self) -> None:
        """No client plays; the next player begins here."""
        self._now = self._reported = None


class Pacer:
    """Schedules the chunks of one paced session by its playhead. `end` is the clock up to which motion was sent."""

    def __init__(self, core: SessionCore, ahead_seconds: float) -> None:
        self.playhead = Playhead()
        self._core, self._size = core, core.chunk.samples
        self._ahead = round(ahead_seconds * SAMPLE_RATE_HZ)
        self._scheduled: dict[int, float] = {}  # when each chunk was scheduled, by its number

    def advance(self, now: float, end: int) -> None:
        """Advance the playhead, and tell the engine."""
        self.playhead.advance(now, end)
        self._core.report_played(self.playhead.sample)

    @property
    def is_due(self) -> bool:
        """Whether a chunk must be made at once, of silence if there is no speech."""
        return self._core.scheduled - self.playhead.sample < self._just_in_time

    def schedule(self, now: float, *, early: bool = False) -> list[int]:
        """Schedule as many chunks as playback allows; returns the first sample of each.

        `early`: another session is due, and a batch costs hardly more than one session, so all go together.
        """
        clocks = []
        while self._core.scheduled - self.playhead.sample < self._bound + early * self._size:
            clocks.append(self._core.scheduled)
            self._scheduled[clocks[-1] // self._size] = now
            self._core.schedule()
        return clocks

    def deadline(self, now: float, end: int) -> float | None:
        """When the next chunk must be scheduled; None if an event must come first: motion, speech or a report."""
        return self.playhead.reaches(self._core.scheduled - self._bound + 1, now, end)

    def took(self, at: int, now: float) -> float | None:
        """Seconds since the chunk that begins at sample `at` was scheduled; None if unknown, or at a second call."""
        then = self._scheduled.pop(at // self._size, None)
        return None if then is None else now - then

    @property
    def _bound(self) -> int:
        """How far ahead of the playhead chunks are scheduled now, in samples."""
        return self._ahead if self._core.waiting >= self._size else self._just_in_time

    @property
    def _just_in_time(self) -> int:
        if self._core.has_music:  # the engine makes music ahead by itself
            return self._core.music_ahead * self._size
        return round((MARGIN_S + min(1.0, 2 * self._core.step_seconds)) * SAMPLE_RATE_HZ)
