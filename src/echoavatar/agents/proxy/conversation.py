"""Turn Realtime events into messages of the avatar's session: the model's speech, the user's speech, interruptions.

The avatar receives whole chunks only, one per message; the last chunk of an item is padded with silence. So a chunk on
its clock holds speech of at most one item, and the n-th chunk with speech of an item is that item's n-th. Frames can
therefore be counted from the start of each item without help from the protocol. The avatar moves by whole chunks
anyway, so nothing is delayed by this.

Playback happens in the client, where the proxy cannot see it. The avatar's playhead follows the wall clock and is never
ahead of playback, because motion cannot exist before its sound. How much was heard is known from three sources: the
time at which sound was forwarded (a client plays it as it arrives), `conversation.item.truncate`, and
`echoavatar.played` from clients that know the proxy. Who only cancels a response tells none: what was due is cut.

A server may leave out what names an item; then its response does, or a name of ours. Sound that comes after the end of
its item, or of another one between, goes on with the item: as a further `SpeechItem` that begins at `first`.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from math import inf

import numpy as np

from echoavatar.timing import CHUNK, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME, ChunkSize
from echoavatar.wire.messages import Audio, Sound

from ..client import Avatar
from ..voice_formats import READABLE, Decoder, Format, Pcm, is_file
from .events import AUDIO_DELTA, AUDIO_DONE, CUTS, PARTS_DONE, SESSION, Event, audio_format, inside, interrupts, sound

_LOG = logging.getLogger(__name__)
STALL_S = 0.5  # an item that receives no sound for longer than this is no longer playing
KEPT_CHUNKS = 32  # of speech already shown, to separate music from speech when motion is remade
GRACE_S = 0.25  # after the user starts to speak: time for the client to report how much was heard
VOID_S = 2.0  # what comes of a response after it was cut off was on its way
TRUNCATE_TOLERANCE = SAMPLE_RATE_HZ // 30  # a truncation closer than this to the estimate changes nothing
BLOCK_BYTES = 48_000  # of sound that are decoded at once: an event may bring minutes, and others go on meanwhile


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
    first: int = 0  # samples of the item that came before, in an earlier part of it
    guess: Format | None = None  # the format, where nobody has told it yet
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
        """Seconds since the sound that has come was over, if it is played as it arrives; negative before."""
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
        """Find an item by its id; of its parts the last, or the one with this sample."""
        for item in reversed(self._items):
            if (item.item_id, item.content_index) == (item_id, content_index) and item.first <= sample:
                return item
        return None

    def of(self, seg: int) -> SpeechItem | None:
        """Find an item by the avatar's utterance number."""
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


class Conversation:
    """What one conversation has said so far, and where it lies on the avatar's clock."""

    def __init__(self) -> None:
        self.items = SpeechItems()
        self._chunk = CHUNK
        self._format: dict[str, Format] = dict.fromkeys(("input", "output"), ("pcm", SAMPLE_RATE_HZ))
        self._told: set[str] = set()  # whose format the server has told
        self._response_format: Format | None = None
        self._asked_format: Format | None = None  # by the client for the next response
        self._response: str | None = None  # the newest response
        self._void: tuple[str | None, float] = None, 0.0  # the response that was cut off, and when
        self._item: str | None = None  # what the server last called an item of the model's
        self._unnamed = 0  # number of the item for which nobody has a name
        self._user_interrupts = True
        self._user_decoder: tuple[Format, Decoder] | None = None
        self._user_segment, self._user_sent = 0, 0
        self._pending_cut: asyncio.Task[None] | None = None
        self._cut_at: int | None = None  # where that will cut
        self._has_missed = False  # something that could not be read, and the log says so

    # ---- the avatar's session

    def attach(self, chunk: ChunkSize = CHUNK) -> None:
        """The avatar's session started or resumed, with chunks of this size. Earlier speech is not sent again."""
        self._chunk = chunk
        self._user_segment, self._user_sent = self._user_segment + 1, 0

    def detach(self) -> None:
        """The avatar's session is gone."""
        self._stop_waiting()
        self.items.forget()

    def on_avatar_sound(self, message: Sound) -> None:
        """Note where a chunk of an item lies on the avatar's clock; call this before the chunk's motion is used."""
        if (item := self.items.of(message.seg)) is not None:
            item.note_returned(message.at)

    # ---- the model

    async def on_server_event(self, event: Event, avatar: Avatar | None, now: float) -> None:
        """Handle an event of the model."""
        kind = event.type
        if kind.endswith(AUDIO_DELTA):
            await self._speak(event, avatar, now)
        elif kind.endswith(AUDIO_DONE) or kind in PARTS_DONE:
            await self._end(self.items.find(self._name(event), event.content_index), avatar)
            self._unnamed += 1
        elif kind == "response.created":
            self._response_format = audio_format(event.response, "output") or self._asked_format
            self._asked_format = None
            self._response, self._item, self._void = event.response_id, None, (None, 0.0)
            self._unnamed += 1
        elif kind in ("response.output_item.added", "conversation.item.created", "conversation.item.added"):
            if inside(event.item, "role") != "user" and inside(event.item, "type") in ("message", None):
                self._item = event.item_id
        elif kind in ("response.done", *CUTS):
            if kind in CUTS or inside(event.response, "status") == "cancelled":
                await self._cut(avatar, now, event.response_id)
            for item in self.items:
                if event.response_id is None or item.response_id in (None, event.response_id):
                    await self._end(item, avatar)
            self._unnamed += 1
        elif kind in SESSION:
            self._update_session(event.session)
        elif kind == "input_audio_buffer.speech_started" and self._user_interrupts:
            await self._cut(avatar, now)

    def miss(self, what: str, why: str) -> None:
        """Log what could not be read, once a conversation."""
        if not self._has_missed:
            self._has_missed = True
            _LOG.warning(
                "the avatar does not move to %.60r: %s; let the voice agent send pcm16, g711_ulaw or g711_alaw in "
                "base64, and say in its session which",
                what,
                why,
            )

    def _update_session(self, session: object, *, is_wish: bool = False) -> None:
        for way in ("input", "output"):
            found = audio_format(session, way)
            if found is not None and not (is_wish and way in self._told and found[0] == self._format[way][0]):
                self._format[way] = found
            if found is not None and not is_wish:
                self._told.add(way)
        user_interrupts = interrupts(session)
        self._user_interrupts = self._user_interrupts if user_interrupts is None else user_interrupts

    def _name(self, event: Event) -> str:
        """What the item of an event is called."""
        return event.item_id or self._item or event.response_id or self._response or f"echoavatar_item_{self._unnamed}"

    async def _speak(self, event: Event, avatar: Avatar | None, now: float) -> None:
        data = sound(event.audio if event.delta is None else event.delta)
        if data is None:
            self.miss(event.type, "its sound is not in base64")
        if not data:
            return
        item, form = self.items.find(self._name(event), event.content_index), self._format["output"]
        if item is not None and item.cut is None and (item.ran_dry(now) > STALL_S or item.guess not in (None, form)):
            await self._end(item, avatar)
        if item is None or (item.is_ended and item.cut is None):
            item = await self._begin(event, data, item, avatar, now)
        if item is not None and item.cut is None:
            item.begun += max(0.0, item.ran_dry(now))
        for block in _blocks(data):
            if item is not None and item.cut is None and not item.is_ended:
                await self._send_chunks(item, item.add(block), avatar)

    async def _begin(
        self, event: Event, data: bytes, before: SpeechItem | None, avatar: Avatar | None, now: float
    ) -> SpeechItem | None:
        """The item that begins with an event, or goes on after its end; None if its format cannot be read."""
        form = self._response_format or self._format["output"]
        if form[0] not in READABLE or is_file(data):
            self.miss(event.type, f"its sound is {form[0] if form[0] not in READABLE else 'a file'}, not samples")
            return None
        await self._end(self.items.newest, avatar)
        item = SpeechItem(
            item_id=self._name(event),
            response_id=event.response_id or self._response,
            output_index=event.output_index,
            content_index=event.content_index,
            decoder=Decoder(*form),
            begun=now,
            chunk=self._chunk,
            first=before.first + before.samples if before is not None else 0,
            guess=None if self._response_format or "output" in self._told else form,
        )
        void, since = self._void
        if avatar is None or (item.response_id is not None and item.response_id == void and now < since + VOID_S):
            item.cut = 0  # the avatar missed its beginning, or it is on its way since the response was cut off
        else:
            await self._finish_cut(avatar)
        self.items.begin(item)
        return item

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

    async def _cut(self, avatar: Avatar | None, now: float, response: str | None = None) -> None:
        """The model stops: the user speaks, or a response is cancelled (this one, if it is named).

        The client may report what was heard; otherwise what was due by now, if sound is played as it arrives, counts.
        """
        playing = self.items.playing_at(now)
        if response is not None and playing is not None and playing.response_id not in (None, response):
            return
        self._void = response or self._response or (playing.response_id if playing else None), now
        self._unnamed += 1
        for item in self.items:
            if item.cut is None and not (item.is_ended and item.heard(now) >= item.samples):
                item.cut = item.heard(now)
        if playing is None or avatar is None:
            return
        await self._finish_cut(avatar)
        self._cut_at = playing.clock_at(playing.heard(now))

        async def cut_at_estimate() -> None:
            await asyncio.sleep(GRACE_S)
            self._pending_cut = None
            await avatar.interrupt(self._cut_at)

        self._pending_cut = asyncio.create_task(cut_at_estimate())

    async def _finish_cut(self, avatar: Avatar) -> None:
        """Wait no longer for the client's report: the model speaks again."""
        if self._stop_waiting():
            await avatar.interrupt(self._cut_at)

    def _stop_waiting(self) -> bool:
        """Do not cut at the estimate; returns whether that was to come."""
        waiting, self._pending_cut = self._pending_cut, None
        return waiting is not None and waiting.cancel()

    @property
    def is_cutting(self) -> bool:
        """Whether an interruption waits for the client's report of how much was heard."""
        return self._pending_cut is not None

    async def _truncate(self, event: Event, avatar: Avatar | None) -> None:
        """The client reports how much of an item was heard."""
        if event.audio_end_ms is None:
            return
        heard = max(0, round(event.audio_end_ms * SAMPLE_RATE_HZ / 1000))
        item = self.items.find(event.item_id, event.content_index, heard)
        if item is None:
            return
        heard -= item.first
        items = list(self.items)
        following = items[items.index(item) + 1 :]
        if item.cut is not None and self._pending_cut is None and any(later.cut is None for later in following):
            return  # it was cut at the estimate, and the model speaks again
        estimate, item.cut = item.cut, heard
        for later in following:  # they will not be heard either
            later.cut = 0 if later.cut is None else later.cut
        if not self._stop_waiting() and estimate is not None and heard > estimate - TRUNCATE_TOLERANCE:
            return  # the avatar was cut there already
        if estimate is None and item.is_ended and heard >= item.samples:
            return  # all of it was heard
        if avatar is not None and item.seg:
            await avatar.interrupt(item.clock_at(heard))

    # ---- the client

    async def on_client_event(self, event: Event, avatar: Avatar | None, now: float) -> None:
        """Handle an event of the client."""
        if event.type == "input_audio_buffer.append":
            await self._send_user_audio(event, avatar)
        elif event.type == "conversation.item.truncate":
            await self._truncate(event, avatar)
        elif event.type in CUTS:
            await self._cut(avatar, now, event.response_id)
        elif event.type == "session.update":
            self._update_session(event.session, is_wish=True)
        elif event.type == "response.create":
            self._asked_format = audio_format(event.response, "output")
        elif event.type == "echoavatar.played" and event.audio_end_ms is not None:
            item = self.items.find(event.item_id, event.content_index)
            if item is not None:
                item.begun = now - event.audio_end_ms / 1000 + item.first / SAMPLE_RATE_HZ

    async def _send_user_audio(self, event: Event, avatar: Avatar | None) -> None:
        """Pass on the user's voice: the avatar looks at the speaker and nods."""
        data, form = sound(event.audio), self._format["input"]
        if data is None or form[0] not in READABLE:
            self.miss(event.type, f"its sound is {'not in base64' if data is None else form[0]}")
            return
        if not data or avatar is None:
            return
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
