"""Utterances on their way in: checked, resampled, cut into chunks; and where on the clock they came to lie."""

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..audio import StreamResampler
from ..timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize
from ..wire import Audio, AudioFormat, ProtocolError, unpack_audio

Samples = Float[np.ndarray, " s"]
KEPT_CHUNKS = 64  # of the ledger, 17 s and more: further than can be taken back


class Span(NamedTuple):
    """A run of one utterance within a chunk."""

    seg: int
    start: int  # samples of the utterance before it, at 24 kHz
    offset: int  # in the chunk
    length: int


class Intake:
    """One speaker's sound: any rate in, 24 kHz chunks out. Bounded; what does not fit is refused, never dropped."""

    def __init__(self, form: AudioFormat, *, seconds: float, chunk: ChunkSize = CHUNK) -> None:
        self._size = chunk.samples
        self.seg = 0  # the newest utterance
        self.received = 0  # samples of it, at its own rate
        self._form = form
        self._room = int(seconds * SAMPLE_RATE_HZ)
        self._resampler = StreamResampler(form.rate)
        self._ended = True
        self._cut = 0  # utterances up to here are not wanted any more
        self._made = 0  # samples of the newest utterance that left the resampler
        self._queue: deque[tuple[int, int, Samples]] = deque()  # utterance, its samples before, samples
        self._waiting = 0
        self._begun = 0  # utterance of which something was taken

    @property
    def waiting(self) -> int:
        """Samples at 24 kHz."""
        return self._waiting

    def push(self, message: Audio) -> Samples:
        """Take in what is new of a message; returns it at its own rate.

        Raises:
            ProtocolError: a gap, sound after the end of its utterance, a full inbox, or samples that are not numbers;
                none of them fatal.
        """
        if message.seg < self.seg or message.seg <= self._cut:
            return np.zeros(0, np.float32)
        samples = unpack_audio(message.pcm, self._form)
        expected = self.received if message.seg == self.seg else 0
        if message.start > expected:
            raise ProtocolError(
                "bad_order",
                f"audio of utterance {message.seg} starts at {message.start}; expected {expected}: send that first",
                fatal=False,
            )
        new = samples[expected - message.start :]
        if self._waiting + len(new) * SAMPLE_RATE_HZ // self._form.rate > self._room:
            raise ProtocolError(
                "inbox_full",
                f"more than {self._room / SAMPLE_RATE_HZ:.0f} s are waiting; send audio as it is played",
                fatal=False,
                retry_after=1.0,
            )
        if message.seg > self.seg:
            self._begin(message.seg)
        elif len(new) and self._ended:
            raise ProtocolError("bad_order", f"utterance {message.seg} has ended; begin another", fatal=False)
        self.received += len(new)
        self._add(self._resampler.push(new))
        return new

    def end(self, seg: int) -> None:
        """The utterance is complete; one that is not known or not wanted any more is passed over."""
        if seg > self.seg and seg > self._cut:
            self._begin(seg)
        if seg == self.seg and not self._ended:
            self._ended = True
            self._add(self._resampler.flush())

    def cut(self, seg: int) -> tuple[int, int]:
        """Utterances up to `seg` are not wanted any more; returns which of them waited first, and where it stood."""
        self._cut = max(self._cut, seg)
        first = next(((part[0], part[1]) for part in self._queue if part[0] <= self._cut), (0, 0))
        kept = [part for part in self._queue if part[0] > self._cut]
        self._queue = deque(kept)
        self._waiting = sum(len(samples) for _, _, samples in kept)
        if self.seg <= self._cut:
            self._ended = True
        return first

    def skip(self) -> None:
        """What waits is not wanted, what follows is."""
        self._queue.clear()
        self._waiting = 0

    def is_drained(self, seg: int) -> bool:
        """Whether the utterance is complete, was not cut off, and all of it was taken."""
        is_over = seg > self._cut and (seg < self.seg or (seg == self.seg and self._ended))
        return is_over and not any(part[0] == seg for part in self._queue)

    def next_chunk(self) -> tuple[Samples, tuple[Span, ...]]:
        """A chunk, completed with silence; an utterance that just begins is not torn for it, but waits."""
        chunk, spans, filled = np.zeros(self._size, np.float32), [], 0
        if self._waiting < self._size and self._is_beginning:
            return chunk, ()
        while filled < self._size and self._queue:
            seg, start, samples = self._queue.popleft()
            part = samples[: self._size - filled]
            chunk[filled : filled + len(part)] = part
            spans.append(Span(seg, start, filled, len(part)))
            filled += len(part)
            self._begun = seg
            if len(part) < len(samples):
                self._queue.appendleft((seg, start + len(part), samples[len(part) :]))
        self._waiting -= filled
        return chunk, _joined(spans)

    @property
    def _is_beginning(self) -> bool:
        return bool(self._queue) and self._queue[0][0] == self.seg != self._begun and not self._ended

    def _begin(self, seg: int) -> None:
        if not self._ended:
            self._add(self._resampler.flush())
        self.seg, self.received, self._made, self._ended = seg, 0, 0, False
        self._resampler = StreamResampler(self._form.rate)

    def _add(self, samples: Samples) -> None:
        if len(samples):
            self._queue.append((self.seg, self._made, samples))
            self._made += len(samples)
            self._waiting += len(samples)


class Ledger:
    """Which utterance lies where on the session's clock."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self._size = chunk.samples
        self._chunks: dict[int, tuple[Span, ...]] = {}
        self._last: dict[int, int] = {}  # clock of the end of an utterance's last sample so far

    def write(self, chunk: int, spans: tuple[Span, ...]) -> None:
        """Chunk number `chunk` of the clock holds these."""
        self._chunks[chunk] = spans
        for span in spans:
            self._last[span.seg] = chunk * self._size + span.offset + span.length
        for old in [known for known in self._chunks if known < chunk - KEPT_CHUNKS]:
            del self._chunks[old]

    def speaks(self, chunk: int) -> int:
        """The utterance of a chunk, 0 for none."""
        return self._chunks[chunk][0].seg if self._chunks.get(chunk) else 0

    def ends(self, clock: int) -> dict[int, int]:
        """Where the last sample so far of each utterance lies, of those that lie before `clock`."""
        return {seg: end for seg, end in self._last.items() if end <= clock}

    def forget(self, seg: int) -> None:
        """Utterances up to this one need not be told of any more."""
        self._last = {known: end for known, end in self._last.items() if known > seg}

    def cut(self, clock: int) -> tuple[int, int]:
        """Nothing from `clock` on came to be heard; returns the utterance that is cut and how much of it was heard."""
        chunk, offset = divmod(clock, self._size)
        kept, lost = [], []
        for span in self._chunks.get(chunk, ()):
            if span.offset < offset:
                kept.append(span._replace(length=min(span.length, offset - span.offset)))
            if span.offset + span.length > offset:
                lost.append(span._replace(start=span.start + max(0, offset - span.offset)))
        lost += [span for known, spans in sorted(self._chunks.items()) if known > chunk for span in spans]
        self._chunks = {known: spans for known, spans in self._chunks.items() if known < chunk}
        self._chunks[chunk] = tuple(kept)
        self._last = {seg: min(end, clock) for seg, end in self._last.items()}
        return (lost[0].seg, lost[0].start) if lost else (0, 0)


def _joined(spans: list[Span]) -> tuple[Span, ...]:
    """Runs of the same utterance as one."""
    out: list[Span] = []
    for span in spans:
        if out and out[-1].seg == span.seg:
            out[-1] = out[-1]._replace(length=out[-1].length + span.length)
        else:
            out.append(span)
    return tuple(out)
