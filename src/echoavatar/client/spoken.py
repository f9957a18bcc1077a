"""What was said, kept until it was played: a resumed session is told the rest, and a new one what is left."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from ..timing import SAMPLE_RATE_HZ
from ..wire import Audio, AudioFormat, End, Flush, Ready, Sound

BLOCK_BYTES = 1 << 16
AHEAD_S = 30.0  # of sound sent ahead of its motion: the server's inbox is bounded
KEPT = 4  # utterances


@dataclass
class Utterance:
    """One, in bytes of the connection's format."""

    seg: int
    pcm: bytearray = field(default_factory=bytearray)
    sent: int = 0
    base: int = 0  # what an earlier session has played is not told to the next
    is_ended: bool = False
    is_over: bool = False  # and the server knows


class Spoken:
    """All utterances of a client, and how far they are."""

    def __init__(self, form: AudioFormat) -> None:
        self.seg = 0  # the newest
        self.received = 0  # clock up to which sound came back
        self._form = form
        self._width = (2 if form.format == "s16le" else 4) * form.channels
        self._said: deque[Utterance] = deque()
        self._sent_s = 0.0
        self._back: dict[int, tuple[int, int]] = {}  # sound that came back: utterance and samples, by clock

    @property
    def seconds_ahead(self) -> float:
        """Sound sent whose motion did not come yet, at most."""
        return self._sent_s - self.received / SAMPLE_RATE_HZ

    def add(self, pcm: bytes, *, end: bool) -> int:
        """Say more, or begin an utterance; returns its number."""
        if not self._said or self._said[-1].is_ended:
            self.seg += 1
            self._said.append(Utterance(self.seg))
            while len(self._said) > KEPT and self._said[0].is_over:
                self._said.popleft()
            known = {utterance.seg for utterance in self._said}
            self._back = {at: part for at, part in self._back.items() if part[0] in known}
        self._said[-1].pcm += pcm
        self._said[-1].is_ended = end
        return self.seg

    def due(self) -> Iterator[Audio | End]:
        """What the server has room for, in order; what is taken counts as sent."""
        seconds = 1 / (self._width * self._form.rate)
        for utterance in self._said:
            while not utterance.is_over:
                if self.seconds_ahead > AHEAD_S:
                    return
                block = bytes(utterance.pcm[utterance.sent : utterance.sent + BLOCK_BYTES])
                if not block:
                    break
                start = (utterance.sent - utterance.base) // self._width
                utterance.sent += len(block)
                self._sent_s += len(block) * seconds
                yield Audio(seg=utterance.seg, start=start, pcm=block)
            if utterance.is_ended and not utterance.is_over:
                utterance.is_over = True
                yield End(seg=utterance.seg)

    def hear(self, sound: Sound) -> None:
        """Sound came back."""
        samples = len(sound.pcm) // 2
        self._back[sound.at] = sound.seg, samples
        self.received = max(self.received, sound.at + samples)

    def flush(self, flush: Flush) -> None:
        """What came back from there on is void."""
        self._back = {at: part for at, part in self._back.items() if at < flush.at}
        self.received = min(self.received, flush.at)

    def interrupt(self) -> None:
        """Nothing of what was said is wanted any more."""
        self._said.clear()
        self._sent_s = self.received / SAMPLE_RATE_HZ

    def go_on(self, ready: Ready) -> None:
        """The session was resumed, and knows what it was told."""
        for utterance in self._said:
            if utterance.seg >= ready.seg:
                known = ready.received * self._width if utterance.seg == ready.seg else 0
                utterance.sent = utterance.base + known
                utterance.is_over = False

    def begin_anew(self, ready: Ready) -> None:
        """Another session has never heard of us: it is told what did not come back yet."""
        for utterance in self._said:
            back = sum(samples for seg, samples in self._back.values() if seg == utterance.seg)
            base = utterance.base + back * self._form.rate // SAMPLE_RATE_HZ * self._width
            utterance.is_over = utterance.is_over and base >= len(utterance.pcm)
            utterance.base = utterance.sent = min(base, len(utterance.pcm))
        self._back.clear()
        self.received, self._sent_s = ready.at, ready.at / SAMPLE_RATE_HZ
