"""What the model says, piece by piece: which chunk of the avatar's clock is which stretch of which Realtime item.

Only whole chunks are handed to the avatar (the last one completed with silence), one message each. So a chunk of its
clock holds speech of one item or none, and the n-th chunk with an item's speech is the n-th of that item: frames can be
counted from the item's own beginning, without a word in the protocol about it. It costs nothing, as the avatar moves
by whole chunks anyway.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int16

from ..timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize
from .decoder import Decoder, Pcm

STALL_S = 0.5  # an item that brings nothing for longer than this is not waited for
KEPT_CHUNKS = 32  # of speech already shown, to tell music from it when motion is made again


@dataclass(eq=False)
class Voice:
    """One item's audio, at 24 kHz."""

    item_id: str
    response_id: str | None
    output_index: int
    content_index: int
    decoder: Decoder
    begun: float  # when its first sound was passed on, by the loop's clock
    chunk: ChunkSize = CHUNK  # of the avatar that is told
    seg: int = 0  # the avatar's number for it; 0: not told yet
    samples: int = 0  # received
    is_ended: bool = False
    is_told: bool = False  # whether its last frame was announced
    cut: int | None = None  # samples heard when it was cut off
    clock: list[int] = field(default_factory=list)  # of the chunks that came back
    _rest: Pcm = field(default_factory=lambda: np.zeros(0, np.int16))
    _chunks: dict[int, Pcm] = field(default_factory=dict)
    _made: int = 0

    @property
    def chunks(self) -> int:
        """How many were made so far."""
        return self._made

    @property
    def is_over(self) -> bool:
        """Whether nothing more of it will be shown."""
        return self.cut is not None or (self.is_ended and len(self.clock) >= self._made)

    def add(self, data: bytes) -> list[Pcm]:
        """More sound; returns the chunks that it completes."""
        new = self.decoder.push(data)
        return self._take(new)

    def end(self) -> list[Pcm]:
        """No more comes; returns the last chunk, completed with silence."""
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
            self._chunks[self._made] = made[-1]
            self._made += 1
        return made

    def came_back(self, at: int) -> int:
        """A chunk of it lies at clock `at`; returns its number."""
        if at in self.clock:
            return self.clock.index(at)
        self.clock.append(at)
        for old in [known for known in self._chunks if known < len(self.clock) - KEPT_CHUNKS]:
            del self._chunks[old]
        return len(self.clock) - 1

    def void(self, at: int) -> None:
        """What came back from clock `at` on is void."""
        self.clock = [known for known in self.clock if known < at]

    def heard(self, now: float) -> int:
        """Samples heard by now, if it was played as it came."""
        return max(0, min(round((now - self.begun) * SAMPLE_RATE_HZ), self.samples))

    def clock_at(self, sample: int) -> int | None:
        """Where on the avatar's clock a sample lies; None where that is not known."""
        chunk, offset = divmod(max(0, sample), self.chunk.samples)
        if chunk < len(self.clock):
            return self.clock[chunk] + offset
        if self.clock and sample <= len(self.clock) * self.chunk.samples:
            return self.clock[-1] + self.chunk.samples
        return None

    def speech(self, chunk: int) -> Int16[np.ndarray, " s"]:
        """What of a chunk is speech; nothing from where it was cut off."""
        known = self._chunks.get(chunk)
        if known is None:
            return np.zeros(self.chunk.samples, np.int16)
        if self.cut is None or self.cut >= (chunk + 1) * self.chunk.samples:
            return known
        kept = known.copy()
        kept[max(0, self.cut - chunk * self.chunk.samples) :] = 0
        return kept

    def frame(self, chunk: int) -> int:
        """Number of a chunk's first frame, counted from the item's beginning."""
        return chunk * self.chunk.frames


class Voices:
    """All that a session says, the newest last; a few that are over are remembered for late truncations."""

    def __init__(self) -> None:
        self._voices: deque[Voice] = deque(maxlen=16)

    def __iter__(self) -> Iterator[Voice]:
        return iter(list(self._voices))

    @property
    def newest(self) -> Voice | None:
        """What was begun last."""
        return self._voices[-1] if self._voices else None

    def begin(self, voice: Voice) -> None:
        """Another one; it is heard after the one before."""
        before = self.newest
        if before is not None and before.cut is None:
            voice.begun = max(voice.begun, before.begun + before.samples / SAMPLE_RATE_HZ)
        self._voices.append(voice)

    def find(self, item_id: str | None, content_index: int = 0) -> Voice | None:
        """By its item."""
        for voice in reversed(self._voices):
            if voice.item_id == item_id and voice.content_index == content_index:
                return voice
        return None

    def of(self, seg: int) -> Voice | None:
        """By the avatar's number."""
        return next((voice for voice in self._voices if seg and voice.seg == seg), None)

    def heard_now(self, now: float) -> Voice | None:
        """What is being heard, if it was played as it came."""
        for voice in self._voices:
            if voice.cut is None and voice.begun <= now:
                over = now - voice.begun - voice.samples / SAMPLE_RATE_HZ
                if over < (0 if voice.is_ended else STALL_S):
                    return voice
        return None

    def forget(self) -> None:
        """The avatar that knew them is gone."""
        for voice in self._voices:
            voice.cut = voice.samples if voice.cut is None else voice.cut
            voice.seg = 0
