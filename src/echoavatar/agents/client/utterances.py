"""The utterances of a client. They are kept until they were played, to be sent again to a resumed or a new session."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import Audio, AudioFormat, End, Flush, Ready, Sound

BLOCK_BYTES = 1 << 16
AHEAD_S = 30.0  # seconds of sound sent ahead of their motion; the server's queue is bounded
KEPT_UTTERANCES = 4


@dataclass
class Utterance:
    """One utterance, in bytes of the connection's audio format."""

    seg: int
    pcm: bytearray = field(default_factory=bytearray)
    sent: int = 0
    base: int = 0  # bytes that an earlier session has played; a new session is not sent them
    is_ended: bool = False
    is_end_sent: bool = False


class UtteranceQueue:
    """The utterances of a client, and how much of each was sent and played."""

    def __init__(self, form: AudioFormat) -> None:
        self.seg = 0  # number of the newest utterance
        self.received = 0  # clock up to which sound has been received
        self._form = form
        self._width = form.width
        self._utterances: deque[Utterance] = deque()
        self._sent_s = 0.0
        self._received_sound: dict[int, tuple[int, int]] = {}  # by clock: utterance, number of samples

    @property
    def seconds_ahead(self) -> float:
        """Upper bound of the seconds of sound sent whose motion has not arrived."""
        return self._sent_s - self.received / SAMPLE_RATE_HZ

    def add(self, pcm: bytes, *, end: bool) -> int:
        """Append sound to the open utterance, or begin one; returns its number. `end` closes it."""
        if not self._utterances or self._utterances[-1].is_ended:
            self.seg += 1
            self._utterances.append(Utterance(self.seg))
            while len(self._utterances) > KEPT_UTTERANCES and self._utterances[0].is_end_sent:
                self._utterances.popleft()
            known = {utterance.seg for utterance in self._utterances}
            self._received_sound = {at: part for at, part in self._received_sound.items() if part[0] in known}
        self._utterances[-1].pcm += pcm
        self._utterances[-1].is_ended = end
        return self.seg

    def due(self) -> Iterator[Audio | End]:
        """The messages that the server has room for, in order; each one taken from the iterator counts as sent."""
        seconds = 1 / (self._width * self._form.rate)
        for utterance in self._utterances:
            while not utterance.is_end_sent:
                if self.seconds_ahead > AHEAD_S:
                    return
                block = bytes(utterance.pcm[utterance.sent : utterance.sent + BLOCK_BYTES])
                if not block:
                    break
                start = (utterance.sent - utterance.base) // self._width
                utterance.sent += len(block)
                self._sent_s += len(block) * seconds
                yield Audio(seg=utterance.seg, start=start, pcm=block)
            if utterance.is_ended and not utterance.is_end_sent:
                utterance.is_end_sent = True
                yield End(seg=utterance.seg)

    def hear(self, sound: Sound) -> None:
        """Note sound that the server sent back."""
        samples = len(sound.pcm) // 2
        self._received_sound[sound.at] = sound.seg, samples
        self.received = max(self.received, sound.at + samples)

    def flush(self, flush: Flush) -> None:
        """Discard what was received from the flush's clock on."""
        self._received_sound = {at: part for at, part in self._received_sound.items() if at < flush.at}
        self.received = min(self.received, flush.at)

    def interrupt(self) -> None:
        """Drop all utterances; the server discards them too."""
        self._utterances.clear()
        self._sent_s = self.received / SAMPLE_RATE_HZ

    def go_on(self, ready: Ready) -> None:
        """Continue after the session was resumed: the server still has what it received."""
        for utterance in self._utterances:
            if utterance.seg >= ready.seg:
                known = ready.received * self._width if utterance.seg == ready.seg else 0
                utterance.sent = utterance.base + known
                utterance.is_end_sent = False

    def begin_anew(self, ready: Ready) -> None:
        """Continue in a new session: it must be sent everything that was not played."""
        for utterance in self._utterances:
            back = sum(samples for seg, samples in self._received_sound.values() if seg == utterance.seg)
            base = utterance.base + back * self._form.rate // SAMPLE_RATE_HZ * self._width
            utterance.is_end_sent = utterance.is_end_sent and base >= len(utterance.pcm)
            utterance.base = utterance.sent = min(base, len(utterance.pcm))
        self._received_sound.clear()
        self.received, self._sent_s = ready.at, ready.at / SAMPLE_RATE_HZ
