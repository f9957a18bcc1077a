"""The items that the model speaks, and which chunk of the avatar's clock belongs to which item.

The avatar receives whole chunks only, one per message; the last chunk of an item is padded with silence. So a chunk on
its clock holds speech of at most one item, and the n-th chunk with speech of an item is that item's n-th. Frames can
therefore be counted from the start of each item without help from the protocol. The avatar moves by whole chunks
anyway, so nothing is delayed by this.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import soxr
from jaxtyping import Int16, UInt8

from echoavatar.timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize

Pcm = Int16[np.ndarray, " _s"]  # blocks of any length, also beside each other
_CODES = np.arange(256, dtype=np.uint8)
STALL_S = 0.5  # an item that receives no sound for longer than this is no longer playing
KEPT_CHUNKS = 32  # of speech already shown, to separate music from speech when motion is remade


class Decoder:
    """Decodes one stream of one format."""

    def __init__(self, kind: str = "pcm", rate: int = SAMPLE_RATE_HZ) -> None:
        self._kind = kind
        self._rest = b""  # an incomplete sample at the end of the last block
        self._stream = (
            None
            if rate == SAMPLE_RATE_HZ
            else soxr.ResampleStream(rate, SAMPLE_RATE_HZ, 1, dtype="int16", quality="HQ")
        )

    def push(self, data: bytes, *, is_last: bool = False) -> Pcm:
        """Decode the next bytes; `is_last` also flushes the resampler."""
        if self._kind == "pcm":
            data = self._rest + data
            whole = len(data) // 2 * 2
            self._rest = data[whole:]
            samples = np.frombuffer(data[:whole], "<i2")
        else:
            samples = _TABLES[self._kind][np.frombuffer(data, np.uint8)]
        if self._stream is None:
            return samples
        made: Pcm = self._stream.resample_chunk(samples, last=is_last)
        return made


def _ulaw(code: UInt8[np.ndarray, " n"]) -> Pcm:
    """Mu-law: 8 segments of 16 steps, inverted bits, bias 33 at 14 bits."""
    code = ~code
    segment, step = (code >> 4) & 7, code & 15
    size = (((2 * step.astype(np.int32) + 33) << segment) - 33) * 4
    return np.where(code & 128, -size, size).astype(np.int16)


def _alaw(code: UInt8[np.ndarray, " n"]) -> Pcm:
    """A-law: the first two segments are linear; every other bit is inverted."""
    code = code ^ 0x55
    segment, step = ((code >> 4) & 7).astype(np.int32), (code & 15).astype(np.int32)
    size = np.where(segment == 0, 2 * step + 1, (2 * step + 33) << np.maximum(segment - 1, 0)) * 8
    return np.where(code & 128, size, -size).astype(np.int16)


_TABLES = {"ulaw": _ulaw(_CODES), "alaw": _alaw(_CODES)}


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
        return chunk * self.chunk.frames


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

    def find(self, item_id: str | None, content_index: int = 0) -> SpeechItem | None:
        """Find an item by its id."""
        for item in reversed(self._items):
            if item.item_id == item_id and item.content_index == content_index:
                return item
        return None

    def of(self, seg: int) -> SpeechItem | None:
        """Find an item by the avatar's utterance number."""
        return next((item for item in self._items if seg and item.seg == seg), None)

    def playing_at(self, now: float) -> SpeechItem | None:
        """The item that is playing at the time `now`, if sound is played as it arrives."""
        for item in self._items:
            if item.cut is None and item.begun <= now:
                over = now - item.begun - item.samples / SAMPLE_RATE_HZ
                if over < (0 if item.is_ended else STALL_S):
                    return item
        return None

    def forget(self) -> None:
        """The avatar's session is gone: cut off every item."""
        for item in self._items:
            item.cut = item.samples if item.cut is None else item.cut
            item.seg = 0
