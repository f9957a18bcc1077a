"""Turn Realtime events into messages of the avatar's session: the model's speech, the user's speech, interruptions.

The avatar receives whole chunks only, one per message; the last chunk of an item is padded with silence. So a chunk on
its clock holds speech of at most one item, and the n-th chunk with speech of an item is that item's n-th. Frames can
therefore be counted from the start of each item without help from the protocol. The avatar moves by whole chunks
anyway, so nothing is delayed by this.

Playback happens in the client, where the proxy cannot see it. The avatar's playhead follows the wall clock and is never
ahead of playback, because motion cannot exist before its sound. How much was heard is known from three sources: the
time at which sound was forwarded (a client plays it as it arrives), `conversation.item.truncate`, and
`echoavatar.played` from clients that know the proxy.
"""

import asyncio
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import soxr
from jaxtyping import Int16, UInt8

from echoavatar.timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize
from echoavatar.wire.messages import Audio, Sound

from ..client import Avatar
from .events import AUDIO_DELTA, AUDIO_DONE, SESSION, Event, audio_format, inside, interrupts, sound

Pcm = Int16[np.ndarray, " _s"]  # blocks of any length, also beside each other
STALL_S = 0.5  # an item that receives no sound for longer than this is no longer playing
KEPT_CHUNKS = 32  # of speech already shown, to separate music from speech when motion is remade
GRACE_S = 0.25  # after the user starts to speak: time for the client to report how much was heard
TRUNCATE_TOLERANCE = SAMPLE_RATE_HZ // 30  # a truncation closer than this to the estimate changes nothing
BLOCK_BYTES = 48_000  # of sound that are decoded at once: an event may bring minutes, and others go on meanwhile


class Decoder:
    """Decodes one stream of one format."""

    def __init__(self, kind: str = "pcm", rate: int = SAMPLE_RATE_HZ) -> None:
        self._kind = kind
        self._rest = b""  # an incomplete sample at the end of the last block
        self._stream = None
        if rate != SAMPLE_RATE_HZ:
            self._stream = soxr.ResampleStream(rate, SAMPLE_RATE_HZ, 1, dtype="int16", quality="HQ")

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


_CODES = np.arange(256, dtype=np.uint8)
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
        wanted = item_id, content_index
        return next((item for item in reversed(self._items) if (item.item_id, item.content_index) == wanted), None)

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


class Conversation:
    """What one conversation has said so far, and where it lies on the avatar's clock."""

    def __init__(self) -> None:
        self.items = SpeechItems()
        self._chunk = CHUNK
        self._format = {"input": ("pcm", SAMPLE_RATE_HZ), "output": ("pcm", SAMPLE_RATE_HZ)}
        self._response_format: tuple[str, int] | None = None
        self._user_interrupts = True
        self._user_decoder: tuple[tuple[str, int], Decoder] | None = None
        self._user_segment, self._user_sent = 0, 0
        self._pending_cut: asyncio.Task[None] | None = None

    # ---- the avatar's session

    def attach(self, chunk: ChunkSize = CHUNK) -> None:
        """The avatar's session started or resumed, with chunks of this size. Earlier speech is not sent again."""
        self._chunk = chunk
        self._user_segment, self._user_sent = self._user_segment + 1, 0

    def detach(self) -> None:
        """The avatar's session is gone."""
        if self._pending_cut is not None:
            self._pending_cut.cancel()
            self._pending_cut = None
        self.items.forget()

    def on_avatar_sound(self, message: Sound) -> None:
        """Note where a chunk of an item lies on the avatar's clock; call this before the chunk's motion is used."""
        item = self.items.of(message.seg)
        if item is not None:
            item.note_returned(message.at)

    # ---- the model

    async def on_server_event(self, event: Event, avatar: Avatar | None, now: float) -> None:
        """Handle an event of the model."""
        if event.type in AUDIO_DELTA:
            await self._speak(event, avatar, now)
        elif event.type in AUDIO_DONE:
            await self._end(self.items.find(event.item_id, event.content_index or 0), avatar)
        elif event.type == "response.created":
            self._response_format = audio_format(event.response, "output")
        elif event.type == "response.done":
            for item in self.items:
                if item.response_id == inside(event.response, "id"):
                    await self._end(item, avatar)
        elif event.type in SESSION:
            self._update_session(event.session)
        elif event.type == "input_audio_buffer.speech_started" and self._user_interrupts:
            self._cut_all(avatar, now)

    def _update_session(self, session: object) -> None:
        for direction in ("input", "output"):
            self._format[direction] = audio_format(session, direction) or self._format[direction]
        user_interrupts = interrupts(session)
        self._user_interrupts = self._user_interrupts if user_interrupts is None else user_interrupts

    async def _speak(self, event: Event, avatar: Avatar | None, now: float) -> None:
        data = sound(event.delta)
        if not data or event.item_id is None:
            return
        item = self.items.find(event.item_id, event.content_index or 0)
        if item is None:
            await self._end(self.items.newest, avatar)
            item = SpeechItem(
                item_id=event.item_id,
                response_id=event.response_id,
                output_index=event.output_index or 0,
                content_index=event.content_index or 0,
                decoder=Decoder(*(self._response_format or self._format["output"])),
                begun=now,
                chunk=self._chunk,
            )
            if avatar is None:
                item.cut = 0  # the avatar missed its beginning, so it does not move to this item at all
            self.items.begin(item)
        for block in _blocks(data):
            if item.cut is None and not item.is_ended:
                await self._send_chunks(item, item.add(block), avatar)

    async def _end(self, item: SpeechItem | None, avatar: Avatar | None) -> None:
        if item is None or item.is_ended:
            return
        chunks = item.end()
        if item.cut is None:
            await self._send_chunks(item, chunks, avatar)
            if avatar is not None and item.seg:
                await avatar.speak(np.zeros(0, np.int16))

    async def _send_chunks(self, item: SpeechItem, chunks: Iterable[Pcm], avatar: Avatar | None) -> None:
        for chunk in chunks:
            await asyncio.sleep(0)
            if avatar is not None and item.cut is None:
                item.seg = await avatar.speak(chunk, end=False)

    # ---- interruptions

    def _cut_all(self, avatar: Avatar | None, now: float) -> None:
        """The user speaks, so the model stops. The client may report what was heard; otherwise an estimate is used."""
        item = self.items.playing_at(now)
        for other in self.items:
            if other.cut is None and not (other.is_ended and other.heard(now) >= other.samples):
                other.cut = other.heard(now)
        if item is None or avatar is None:
            return
        at = item.clock_at(item.heard(now))

        async def cut_at_estimate() -> None:
            await asyncio.sleep(GRACE_S)
            self._pending_cut = None
            await avatar.interrupt(at)

        self._pending_cut = asyncio.create_task(cut_at_estimate())

    @property
    def is_cutting(self) -> bool:
        """Whether an interruption waits for the client's report of how much was heard."""
        return self._pending_cut is not None

    async def _truncate(self, event: Event, avatar: Avatar | None) -> None:
        """The client reports how much of an item was heard."""
        item = self.items.find(event.item_id, event.content_index or 0)
        if item is None or event.audio_end_ms is None:
            return
        heard = max(0, round(event.audio_end_ms * SAMPLE_RATE_HZ / 1000))
        estimate, item.cut = item.cut, heard
        items = list(self.items)
        for later in items[items.index(item) + 1 :]:  # they will not be heard either
            later.cut = 0 if later.cut is None else later.cut
        if self._pending_cut is not None:
            self._pending_cut.cancel()
            self._pending_cut = None
        elif estimate is not None and heard > estimate - TRUNCATE_TOLERANCE:
            return  # the avatar was cut there already
        if estimate is None and item.is_ended and heard >= item.samples:
            return  # all of it was heard
        if avatar is not None and item.seg:
            await avatar.interrupt(item.clock_at(heard))

    # ---- the client

    async def on_client_event(self, event: Event, avatar: Avatar | None, now: float) -> None:
        """Handle an event of the client."""
        if event.type == "input_audio_buffer.append":
            await self._send_user_audio(sound(event.audio), avatar)
        elif event.type == "conversation.item.truncate":
            await self._truncate(event, avatar)
        elif event.type == "echoavatar.played" and event.audio_end_ms is not None:
            item = self.items.find(event.item_id, event.content_index or 0)
            if item is not None:
                item.begun = now - event.audio_end_ms / 1000

    async def _send_user_audio(self, data: bytes, avatar: Avatar | None) -> None:
        """Pass on the user's voice: the avatar looks at the speaker and nods."""
        if not data or avatar is None:
            return
        form = self._format["input"]
        if self._user_decoder is None or self._user_decoder[0] != form:
            self._user_decoder = (form, Decoder(*form))
        for block in _blocks(data):
            await asyncio.sleep(0)
            samples = self._user_decoder[1].push(block)
            pcm = samples.astype("<i2").tobytes()
            await avatar.send(Audio(seg=self._user_segment, start=self._user_sent, pcm=pcm, speaker="user"))
            self._user_sent += len(samples)


def _blocks(data: bytes) -> Iterator[bytes]:
    return (data[at : at + BLOCK_BYTES] for at in range(0, len(data), BLOCK_BYTES))
