"""Estimate how far a framework has played: from its reports of written sound, and from the wall clock in between.

Frameworks receive sound ahead of time, and most report little about when it is heard. During silence no reports come,
so the clock must run on without them. While a framework that does report is stuck, the clock must stop.
"""

from collections import deque
from dataclasses import dataclass

from echoavatar.timing import SAMPLE_RATE_HZ

GRACE_S = 0.1  # a framework writes in blocks; after a block it is assumed to play on for this long
REST_S = 0.06  # up to this much may stay unwritten until more sound comes: less than a block


@dataclass
class _Span:
    start: int  # its clock
    samples: int
    written: float = 0.0  # in samples


class Playback:
    """Estimates the clock of the first sample that was not heard; times are seconds of any monotonic clock."""

    def __init__(self, at: int, now: float) -> None:
        self.end = at  # clock up to which there is something to play
        self._at, self._now = float(at), now
        self._spans: deque[_Span] = deque()  # sound that is not written completely
        self._reports = False

    def pushed(self, start: int, samples: int, *, audible: bool) -> None:
        """A stretch of the session was released. A stretch that is not audible was not handed to the framework."""
        self.end = start + samples
        if audible:
            self._spans.append(_Span(start, samples))

    def wrote(self, seconds: float, now: float) -> None:
        """The framework has written this much sound to its device or connection."""
        self._reports = True
        samples = seconds * SAMPLE_RATE_HZ
        while samples > 0 and self._spans:
            span = self._spans[0]
            part = min(samples, span.samples - span.written)
            span.written += part
            samples -= part
            self._at, self._now = span.start + span.written, now
            if span.samples - span.written < 1:
                self._spans.popleft()

    def plays(self, at: int, now: float) -> None:
        """The framework knows that exactly this sample is being heard."""
        self._at, self._now = float(min(at, self.end)), now
        self._spans = deque(span for span in self._spans if span.start + span.samples > at)

    def position(self, now: float) -> int:
        """The clock of the first sample that was not heard."""
        self._at = max(self._at, min(self._at + (now - self._now) * SAMPLE_RATE_HZ, self._bound()))
        self._now = now
        return round(self._at)

    def jump(self, at: int, now: float) -> None:
        """Everything after `at` was discarded; the listener is at `at`."""
        self.end = at
        self._at, self._now = float(at), now
        self._spans.clear()

    @property
    def is_sounding(self) -> bool:
        """Whether sound was released that may not have been heard yet."""
        return any(span.start + span.samples > self._at for span in self._spans)

    def _bound(self) -> float:
        """The latest position that the wall clock may reach without a report."""
        if not self._reports:
            while self._spans and self._spans[0].start + self._spans[0].samples <= self._at:
                self._spans.popleft()
            return float(self.end)
        for span in self._spans:
            if span.samples - span.written > REST_S * SAMPLE_RATE_HZ:
                return min(float(self.end), span.start + span.written + GRACE_S * SAMPLE_RATE_HZ)
        return float(self.end)
