"""Where the listener is, while a framework plays: by what it says it wrote, and by the wall clock in between.

Frameworks are handed sound ahead of time and most say little about when it is heard. Time goes by on its own where
nothing is to be heard, so the clock must not wait for reports then; and it must not run on while a framework that does
report is stuck.
"""

from collections import deque
from dataclasses import dataclass

from ..timing import SAMPLE_RATE_HZ

GRACE_S = 0.1  # a framework writes in blocks: so long after a block it is taken to play on
REST_S = 0.06  # less than a block may stay unwritten until more sound comes


@dataclass
class _Span:
    start: int  # clock
    samples: int
    written: float = 0.0  # samples


class Playback:
    """An estimate of the first sample of the session that was not heard, in seconds of any monotonic clock."""

    def __init__(self, at: int, now: float) -> None:
        self.end = at  # clock up to which there is something to play
        self._at, self._now = float(at), now
        self._spans: deque[_Span] = deque()  # sound that is not written yet
        self._reports = False

    def pushed(self, start: int, samples: int, *, audible: bool) -> None:
        """The framework was given so much of the session; what is not audible it was not given, and takes its time."""
        self.end = start + samples
        if audible:
            self._spans.append(_Span(start, samples))

    def wrote(self, seconds: float, now: float) -> None:
        """The framework has written so much sound to the device or the line."""
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
        """The framework knows exactly: this sample is being heard."""
        self._at, self._now = float(min(at, self.end)), now
        self._spans = deque(span for span in self._spans if span.start + span.samples > at)

    def position(self, now: float) -> int:
        """The estimate."""
        self._at = max(self._at, min(self._at + (now - self._now) * SAMPLE_RATE_HZ, self._bound()))
        self._now = now
        return round(self._at)

    def jump(self, at: int, now: float) -> None:
        """What lay after was taken back; the listener stands here."""
        self.end = at
        self._at, self._now = float(at), now
        self._spans.clear()

    @property
    def is_sounding(self) -> bool:
        """Whether sound was given that may not be heard yet."""
        return any(span.start + span.samples > self._at for span in self._spans)

    def _bound(self) -> float:
        """How far the wall clock may go."""
        if not self._reports:
            while self._spans and self._spans[0].start + self._spans[0].samples <= self._at:
                self._spans.popleft()
            return float(self.end)
        for span in self._spans:
            if span.samples - span.written > REST_S * SAMPLE_RATE_HZ:
                return min(float(self.end), span.start + span.written + GRACE_S * SAMPLE_RATE_HZ)
        return float(self.end)
