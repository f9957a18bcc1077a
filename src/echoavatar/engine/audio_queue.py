"""A session's speech between the caller and the model: resampled once, kept by utterance, laid on the clock in chunks.

    push -> resampler -> waiting utterances --schedule--> chunks on the clock --take--> model
                                                               ^                   |
                                                               +---- go_back ------+

Speech waits until it is scheduled; only then does it have a place on the session's clock. A free-running queue (the
Python API) schedules by itself as soon as a whole chunk waits. A paced queue (the server) schedules when it is told to,
because a live source must not run far ahead of playback. Chunks that the model has taken stay in the queue for as
long as the session can go back to them, so a barge-in only moves the reading position.

The queue is bounded. Speech that does not fit is refused, never dropped.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError, QueueFullError
from echoavatar.models.audio import StreamResampler
from echoavatar.timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize

Samples = Float[np.ndarray, " s"]
QUEUE_SECONDS = 600.0  # agents deliver speech faster than it is spoken, so the bound is generous
MAX_UTTERANCES = 256  # most that may wait
KEPT_S = 17.0  # how long spans are kept; a session cannot go back so far


class Span(NamedTuple):
    """A run of one utterance within a chunk, in samples at 24 kHz."""

    utterance: int
    start: int  # samples of the utterance before this run
    offset: int  # of the run in the chunk
    length: int


class HeardUntil(NamedTuple):
    """Where an utterance was cut off."""

    utterance: int  # 0: none was cut off
    samples: int  # how many of its samples were heard, at 24 kHz


class _Piece(NamedTuple):
    utterance: int
    start: int  # samples of the utterance before this piece
    samples: Samples


class AudioQueue:
    """The speech of one session, from push to model. Not thread-safe: the session holds its lock around every call."""

    def __init__(
        self, chunk: ChunkSize = CHUNK, *, rewind: int = 0, seconds: float = QUEUE_SECONDS, is_paced: bool = False
    ) -> None:
        """`rewind`: how many chunks before the one being made can be taken again; `seconds`: most speech to wait."""
        self.waiting = 0  # samples at 24 kHz that are not scheduled
        self.newest, self.pushed = 0, 0  # the newest utterance, and its samples that left the resampler
        self._size, self._rewind, self._kept = chunk.samples, rewind, chunk.within(KEPT_S)
        self._seconds, self._is_paced = seconds, is_paced
        self._resampler: StreamResampler | None = None
        self._is_finished = False
        # utterances
        self._is_complete = True  # whether the newest utterance is complete
        self._begun = 0  # the newest utterance of which something was scheduled
        self._pieces: deque[_Piece] = deque()
        self._count = 0  # utterances among the pieces
        # the clock, by chunk number; the chunk at `_scheduled` may be there in part
        self._next, self._scheduled = 0, 0
        self._chunks: dict[int, Samples] = {}
        self._spans: dict[int, tuple[Span, ...]] = {}
        self._ends: dict[int, int] = {}  # where on the clock utterances end, until `take_finished` returns them

    # ---- waiting speech

    def push(self, audio: Float[np.ndarray, "..."], rate: int, utterance: int = 0) -> None:
        """Add speech. A higher `utterance` than before begins a new one; callers without utterances leave it at 0.

        Raises:
            AudioError: the samples or the rate are invalid.
            QueueFullError: too much speech, or too many utterances are waiting.
            EchoAvatarError: the queue is finished.
        """
        if self._is_finished:
            raise EchoAvatarError("this session is finished; open a new one to push more audio")
        self._check_room(len(audio) / max(rate, 1), is_new=utterance > self.newest)
        if utterance > self.newest:
            self._begin(utterance)
        if self._resampler is None or self._resampler.rate != rate:
            self._flush()
            self._resampler = StreamResampler(rate)
        self._append(self._resampler.push(audio))

    def end_utterance(self, utterance: int) -> None:
        """The utterance is complete."""
        if utterance > self.newest:
            self._begin(utterance)
        if utterance == self.newest and not self._is_complete:
            self._is_complete = True
            self._flush()

    def finish(self) -> None:
        """No more speech will come: silence completes the last chunk."""
        if not self._is_finished:
            self._flush()
            self._append(np.zeros(-(self._in_hand + self.waiting) % self._size, np.float32))
            self._is_finished = True

    # ---- the clock

    @property
    def end(self) -> int:
        """Sample of the clock up to which whole chunks are scheduled."""
        return self._scheduled * self._size

    @property
    def seconds(self) -> float:
        """Seconds of speech that the model has not taken yet."""
        return (self.end + self._in_hand + self.waiting - self._next * self._size) / SAMPLE_RATE_HZ

    @property
    def has_chunk(self) -> bool:
        """Whether the model can take a chunk without silence being made for it."""
        is_due = not self._is_paced and self._in_hand + self.waiting >= self._size
        return self._next < self._scheduled or is_due

    def schedule(self) -> None:
        """Lay the next chunk on the clock, completed with silence.

        Silence does not tear an utterance that has just begun: a whole chunk of silence goes before it, and by the next
        chunk more of the utterance may be there.
        """
        first = self._pieces[0].utterance if self._pieces else 0
        is_beginning = first == self.newest != self._begun and not self._is_complete
        self._lay(with_speech=self.waiting >= self._size or not is_beginning)

    def stall(self) -> None:
        """The source is late: complete the chunk in hand with silence, so that idle motion goes on."""
        if not self.has_chunk:
            if not self._is_paced:
                self._flush()
            self._lay(with_speech=not self._is_paced)

    def take(self) -> Samples:
        """The next chunk for the model; silence where too little speech is there."""
        if self._next == self._scheduled:
            if self.has_chunk:
                self._lay(with_speech=True)
            else:
                self.stall()
        speech = self._chunks[self._next]
        self._next += 1
        self._chunks.pop(self._next - self._rewind - 2, None)
        return speech

    def go_back(self, chunk: int) -> None:
        """The model takes this chunk again, and all after it."""
        self._next = chunk

    def cut(self, sample: int, last: int | None = None, *, heard: int = 0) -> HeardUntil:
        """Forget speech scheduled after a sample of the clock, and every waiting utterance up to `last` (None: all).

        Returns the utterance that was cut off, and how much of it was heard: up to `sample`, or `heard` if that is
        later. The clock of a paced queue holds whole chunks, so silence completes the last one.
        """
        last = self.newest if last is None else last
        waiting = self._drop(last)
        lost = self._first_after(max(sample, heard))
        self._cut_clock(*divmod(sample, self._size))
        self._ends = {u: min(end, sample) for u, end in self._ends.items() if u > last}
        if self._is_paced:
            self._lay(with_speech=False)
        return lost if lost.utterance else waiting

    # ---- utterances on the clock

    def utterance_at(self, chunk: int) -> int:
        """The first utterance in a chunk, 0 for none."""
        spans = self._spans.get(chunk)
        return spans[0].utterance if spans else 0

    def origins(self) -> dict[int, int]:
        """Where on the clock each utterance begins that is scheduled or waits, going by its newest run."""
        found = {
            span.utterance: number * self._size + span.offset - span.start
            for number, spans in self._spans.items()
            for span in spans
        }
        end = self.end + self._in_hand
        for piece in self._pieces:
            found.setdefault(piece.utterance, end - piece.start)
            end += len(piece.samples)
        return found

    def take_finished(self, clock: int) -> tuple[int, int] | None:
        """The newest utterance that ended by sample `clock` since the last call, and its end; None if none did."""
        done = None
        while self._ends:
            utterance, end = next(iter(self._ends.items()))
            if end > clock or not self.is_drained(utterance):
                break
            del self._ends[utterance]
            done = utterance, end
        return done

    def is_drained(self, utterance: int) -> bool:
        """Whether an utterance is complete and none of it waits any more."""
        is_over = utterance < self.newest or (utterance == self.newest and self._is_complete)
        return is_over and (not self._pieces or self._pieces[0].utterance > utterance)

    # ---- inside

    @property
    def _in_hand(self) -> int:
        """Samples of the chunk that is scheduled in part."""
        return len(self._chunks.get(self._scheduled, ()))

    def _check_room(self, seconds: float, *, is_new: bool) -> None:
        is_whole = seconds > self._seconds  # it would never fit
        remedy = "send it in parts" if is_whole else "let the session play some of it before you send more"
        if self.waiting / SAMPLE_RATE_HZ + seconds > self._seconds:
            raise QueueFullError(f"more than {self._seconds:.0f} s of audio are waiting; {remedy}")
        if is_new and self._count >= MAX_UTTERANCES:
            raise QueueFullError(f"{MAX_UTTERANCES} utterances are waiting; {remedy}")

    def _begin(self, utterance: int) -> None:
        if not self._is_complete:
            self._flush()
        self.newest, self.pushed, self._is_complete = utterance, 0, False
        self._resampler = None

    def _flush(self) -> None:
        if self._resampler is not None:
            self._append(self._resampler.flush())
            self._resampler = None

    def _append(self, samples: Samples) -> None:
        """Short pieces of one utterance are joined, so a flood of them costs no more than its samples."""
        if not len(samples):
            return
        last = self._pieces[-1] if self._pieces else None
        if last is not None and last.utterance == self.newest and len(last.samples) < self._size:
            self._pieces[-1] = last._replace(samples=np.concatenate([last.samples, samples]))
        else:
            self._count += last is None or last.utterance != self.newest
            self._pieces.append(_Piece(self.newest, self.pushed, samples))
        self.pushed += len(samples)
        self.waiting += len(samples)

    def _lay(self, *, with_speech: bool) -> None:
        """Complete the chunk at the end of the clock."""
        number, chunk = self._scheduled, np.zeros(self._size, np.float32)
        spans, filled = list(self._spans.get(number, ())), self._in_hand
        if filled:
            chunk[:filled] = self._chunks[number]
        while with_speech and filled < self._size and self._pieces:
            utterance, start, samples = self._pop(self._size - filled)
            chunk[filled : filled + len(samples)] = samples
            if spans and spans[-1].utterance == utterance:
                spans[-1] = spans[-1]._replace(length=spans[-1].length + len(samples))
            else:
                spans.append(Span(utterance, start, filled, len(samples)))
            filled += len(samples)
            self._begun = utterance
            self._ends[utterance] = number * self._size + filled
        self._chunks[number], self._spans[number] = chunk, tuple(spans)
        self._scheduled += 1
        self._spans.pop(number - self._kept - 1, None)

    def _pop(self, most: int) -> _Piece:
        """Take at most `most` samples of the first waiting piece."""
        first = self._pieces.popleft()
        taken = first._replace(samples=first.samples[:most])
        if len(first.samples) > most:
            rest = first._replace(start=first.start + most, samples=first.samples[most:])
            self._pieces.appendleft(rest)
        elif not self._pieces or self._pieces[0].utterance != first.utterance:
            self._count -= 1
        self.waiting -= len(taken.samples)
        return taken

    def _drop(self, last: int) -> HeardUntil:
        """Drop waiting utterances up to `last`; returns the first of them, and where it stood."""
        first = self._pieces[0] if self._pieces and self._pieces[0].utterance <= last else None
        self._pieces = deque(piece for piece in self._pieces if piece.utterance > last)
        self.waiting = sum(len(piece.samples) for piece in self._pieces)
        self._count = len({piece.utterance for piece in self._pieces})
        if self.newest <= last:
            self._is_complete = True
            self._resampler = None
        return HeardUntil(first.utterance, first.start) if first else HeardUntil(0, 0)

    def _first_after(self, sample: int) -> HeardUntil:
        """The first utterance on the clock at or after a sample, and how much of it lies before the sample."""
        chunk, offset = divmod(sample, self._size)
        for number in range(chunk, self._scheduled + 1):
            for span in self._spans.get(number, ()):
                before = max(0, offset - span.offset) if number == chunk else 0
                if before < span.length:
                    return HeardUntil(span.utterance, span.start + before)
        return HeardUntil(0, 0)

    def _cut_clock(self, chunk: int, offset: int) -> None:
        """Keep `offset` samples of a chunk, and nothing after them."""
        spans, speech = self._spans.pop(chunk, ()), self._chunks.pop(chunk, None)
        for later in range(chunk + 1, self._scheduled + 1):
            self._spans.pop(later, None)
            self._chunks.pop(later, None)
        if speech is not None and offset:
            self._chunks[chunk] = speech[:offset]
            kept = [span for span in spans if span.offset < offset]
            self._spans[chunk] = tuple(span._replace(length=min(span.length, offset - span.offset)) for span in kept)
        self._next, self._scheduled = min(self._next, chunk), chunk
