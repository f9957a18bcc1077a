"""The items of a conversation that are speech, cut into the avatar's chunks, and where these lie on its clock.

The avatar receives whole chunks only, one per message; the last chunk of an item is padded with silence. So a chunk on
its clock holds speech of at most one item, and the n-th chunk with speech of an item is that item's n-th. Frames can
therefore be counted from the start of each item without help from the protocol. The avatar moves by whole chunks
anyway, so nothing is delayed by this.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import inf

import numpy as np

from echoavatar.timing import CHUNK, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME, ChunkSize

from ..timed_text import TimedText
from ..voice_formats import Decoder, Format, Pcm

STALL_S = 0.5  # an item that receives no sound for longer than this is no longer playing
KEPT_CHUNKS = 64  # of speech already shown, to separate music from speech when motion is remade


@dataclass(eq=False)
class SpeechItem:
    """The audio of one item, at 24 kHz."""

    item_id: str
    response_id: str | None
    output_index: int
    content_index: int
    decoder: Decoder
    begun: float  # time by the loop's clock at which its first sound was forwarded
    chunk: ChunkSize = CHUNK  # chunk size of the avatar that receives it
    first: int = 0  # samples in earlier parts of the item
    text: TimedText = field(default_factory=TimedText)
    guess: Format | None = None  # the assumed format, if none was stated yet
    seg: int = 0  # the avatar's number for it; 0: not sent yet
    samples: int = 0  # received so far
    is_ended: bool = False
    is_announced: bool = False  # whether its last face frame was announced
    cut: int | None = None  # samples heard when it was cut off
    clock: list[int] = field(default_factory=list)  # of each chunk that came back from the avatar
    _rest: Pcm = field(default_factory=lambda: np.zeros(0, np.int16))
    _chunks: dict[int, Pcm] = field(default_factory=dict)
    _chunk_count: int = 0

    @property
    def is_over(self) -> bool:
        """Whether no more of it will be shown."""
        return self.cut is not None or (self.is_ended and len(self.clock) >= self._chunk_count)

    def add(self, data: bytes) -> list[Pcm]:
        """Append sound; returns the chunks that are now complete."""
        return self._take(self.decoder.push(data))

    def end(self) -> list[Pcm]:
        """End the item; returns the remaining chunks, the last one padded with silence."""
        self.is_ended = True
        chunks = self._take(self.decoder.push(b"", is_last=True))
        if len(self._rest):
            chunks += self._take(np.zeros(self.chunk.samples - len(self._rest), np.int16), is_silence=True)
        return chunks

    def _take(self, new: Pcm, *, is_silence: bool = False) -> list[Pcm]:
        self.samples += 0 if is_silence else len(new)
        self._rest = np.concatenate([self._rest, new])
        made = []
        while len(self._rest) >= self.chunk.samples:
            made.append(self._rest[: self.chunk.samples])
            self._rest = self._rest[self.chunk.samples :]
            self._chunks[self._chunk_count] = made[-1]
            self._chunk_count += 1
        return made

    def note_returned(self, at: int) -> None:
        """Note that the next chunk lies at clock `at`."""
        if at not in self.clock:
            self.clock.append(at)
            self._chunks.pop(len(self.clock) - KEPT_CHUNKS - 1, None)

    def void(self, at: int) -> None:
        """Forget the chunks that came back from clock `at` on."""
        self.clock = [known for known in self.clock if known < at]

    def heard(self, now: float) -> int:
        """Samples heard by now, if the sound is played as it arrives."""
        return max(0, min(round((now - self.begun) * SAMPLE_RATE_HZ), self.samples))

    def ran_dry(self, now: float) -> float:
        """Seconds since the end of the sound received so far, if it is played as it arrives; negative before."""
        return now - self.begun - self.samples / SAMPLE_RATE_HZ

    def clock_at(self, sample: int) -> int | None:
        """The avatar's clock of a sample; None if it is not known."""
        chunk, offset = divmod(max(0, sample), self.chunk.samples)
        if chunk < len(self.clock):
            return self.clock[chunk] + offset
        if self.clock and sample <= len(self.clock) * self.chunk.samples:
            return self.clock[-1] + self.chunk.samples
        return None

    def speech(self, chunk: int) -> Pcm:
        """The speech in a chunk; silence from where the item was cut off."""
        known = self._chunks.get(chunk)
        if known is None:
            return np.zeros(self.chunk.samples, np.int16)
        if self.cut is None or self.cut >= (chunk + 1) * self.chunk.samples:
            return known
        kept = known.copy()
        kept[max(0, self.cut - chunk * self.chunk.samples) :] = 0
        return kept

    def frame(self, chunk: int) -> int:
        """The number of a chunk's first frame, counted from the start of the item."""
        return self.first // SAMPLES_PER_FRAME + chunk * self.chunk.frames


class SpeechItems:
    """The items of a session, the newest last; finished ones are kept for late truncations."""

    def __init__(self) -> None:
        self._items: deque[SpeechItem] = deque(maxlen=16)

    def __iter__(self) -> Iterator[SpeechItem]:
        return iter(list(self._items))

    @property
    def newest(self) -> SpeechItem | None:
        """The item that began last."""
        return self._items[-1] if self._items else None

    def begin(self, item: SpeechItem) -> None:
        """Add an item; it is heard after the one before it."""
        before = self.newest
        if before is not None and before.cut is None:
            item.begun = max(item.begun, before.begun + before.samples / SAMPLE_RATE_HZ)
        self._items.append(item)

    def find(self, item_id: str | None, content_index: int = 0, sample: float = inf) -> SpeechItem | None:
        """Find an item by its id: its last part, or the part that holds `sample`; None if it is not known."""
        for item in reversed(self._items):
            if (item.item_id, item.content_index) == (item_id, content_index) and item.first <= sample:
                return item
        return None

    def of(self, seg: int) -> SpeechItem | None:
        """Find an item by the avatar's utterance number; None if there is none."""
        return next((item for item in self._items if seg and item.seg == seg), None)

    def playing_at(self, now: float) -> SpeechItem | None:
        """The item that is playing at the time `now`, if sound is played as it arrives."""
        for item in self._items:
            if item.cut is None and item.begun <= now and item.ran_dry(now) < (0 if item.is_ended else STALL_S):
                return item
        return None

    def forget(self) -> None:
        """The avatar's session is gone: cut off every item."""
        for item in self._items:
            item.cut = item.samples if item.cut is None else item.cut
            item.seg = 0
