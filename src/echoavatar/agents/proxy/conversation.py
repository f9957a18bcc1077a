"""Turn Realtime events into messages of the avatar's session: the model's speech, the user's speech, interruptions.

Playback happens in the client, where the proxy cannot see it. The avatar's playhead follows the wall clock and is never
ahead of playback, because motion cannot exist before its sound. How much was heard is known from three sources: the
time at which sound was forwarded (a client plays it as it arrives), `conversation.item.truncate`, and
`echoavatar.played` from clients that know the proxy. A client that only cancels a response reports nothing: then what
was due by that time counts as heard.

If a server leaves out an item's id, the id of its response names it, or a name of ours. Sound that comes after its item
ended, or after another one began, continues the item as a further `SpeechItem`, whose `first` is not 0.
"""

import asyncio
import logging
from collections.abc import Iterable, Iterator
from math import inf, nan

import numpy as np

from echoavatar.timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize
from echoavatar.wire.messages import Audio, Sound

from ..client import Avatar
from ..timed_text import TimedText
from ..voice_formats import READABLE, Decoder, Format, Pcm, is_file
from .events import AUDIO_DELTA, AUDIO_DONE, CUTS, PARTS_DONE, SESSION, Event, audio_format, inside, interrupts, sound
from .speech_items import STALL_S, SpeechItem, SpeechItems

_LOG = logging.getLogger(__name__)
GRACE_S = 0.25  # after the user starts to speak: time for the client to report how much was heard
VOID_S = 2.0  # sound that comes so soon after its response was cut off was on its way, and is not shown
TRUNCATE_TOLERANCE = SAMPLE_RATE_HZ // 30  # only a truncation earlier than the estimate by this much counts
_OVER = ("response.done", "response.cancelled")
_NOTHING: tuple[str | None, float] = None, -inf
BLOCK_BYTES = 48_000  # of sound decoded at once: an event may bring minutes, and other conversations go on meanwhile


class Conversation:
    """What one conversation has said so far, and where it lies on the avatar's clock."""

    def __init__(self) -> None:
        self.items = SpeechItems()
        self._chunk = CHUNK
        self._format: dict[str, Format] = dict.fromkeys(("input", "output"), ("pcm", SAMPLE_RATE_HZ))
        self._told: set[str] = set()  # directions whose format the server has stated
        self._response_format: Format | None = None
        self._asked_format: Format | None = None  # what the client asked for in the next response
        self._response: str | None = None  # the newest response
        self._void = _NOTHING  # the response that was cut off, and when
        self._awaited = ""  # "create" or "cancel": the client's last word on a response that has not begun
        self._item: str | None = None  # id of the model's newest item
        self._unnamed = 0  # number in the name of an item without an id
        self._text = TimedText()  # of an item whose sound has not come yet
        self._user_interrupts = True
        self._user_decoder: tuple[Format, Decoder] | None = None
        self._user_segment, self._user_sent = 0, 0
        self._pending_cut: asyncio.Task[None] | None = None
        self._cut_at: int | None = None  # the avatar's clock at which `_pending_cut` will cut
        self._has_missed = False  # whether the log says that an event could not be read

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
        elif kind == "response.audio_timestamp.delta":
            await self._take_word(event, avatar)
        elif kind.endswith(AUDIO_DONE) or kind in PARTS_DONE:
            await self._end(self.items.find(self._name(event), event.content_index), avatar)
            self._unnamed += 1
            self._void = self._void if self._void[0] else _NOTHING
        elif kind == "response.created":
            self._response_format = audio_format(event.response, "output") or self._asked_format
            self._asked_format = None
            self._response, self._item = event.response_id, None
            self._void = (event.response_id, now) if self._awaited == "cancel" else _NOTHING
            self._awaited = ""
            self._text = TimedText()
            self._unnamed += 1
        elif kind in ("response.output_item.added", "conversation.item.created", "conversation.item.added"):
            if inside(event.item, "role") != "user" and inside(event.item, "type") in ("message", None):
                self._item = event.item_id
        elif kind in (*_OVER, *CUTS):
            if kind in CUTS or inside(event.response, "status") == "cancelled":
                await self._cut(avatar, now, event.response_id)
            for item in self.items:
                if event.response_id is None or item.response_id in (None, event.response_id):
                    await self._end(item, avatar)
            self._unnamed += 1
            self._void = self._void if self._void[0] or kind not in _OVER else _NOTHING
        elif kind == "error":
            self._awaited = ""
        elif kind in SESSION:
            self._update_session(event.session)
        elif kind == "input_audio_buffer.speech_started" and self._user_interrupts:
            await self._cut(avatar, now)

    def miss(self, what: str, why: str) -> None:
        """Log that an event could not be read, once a conversation."""
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
        """The id of an event's item, or a name in its place."""
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
        """Begin an item, or continue the ended item `before`; None if its format cannot be read."""
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
            text=self._text,
            guess=None if self._response_format or "output" in self._told else form,
        )
        self._text = TimedText()
        void, since = self._void
        if avatar is None or (item.response_id == void and now < since + VOID_S):
            item.cut = 0  # the avatar missed its beginning, or its response was cut off before it came
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
        if avatar is not None and item.seg and item.cut is None and (words := item.text.take()):
            await avatar.words(words, seg=item.seg)

    async def _take_word(self, event: Event, avatar: Avatar | None) -> None:
        """Azure sends the time of each word of a response, if its session asks for that."""
        if event.audio_offset_ms is None or not isinstance(event.text, str):
            return
        start = event.audio_offset_ms / 1000
        end = start + (nan if event.audio_duration_ms is None else event.audio_duration_ms / 1000)
        item = self.items.find(self._name(event), event.content_index, start * SAMPLE_RATE_HZ)
        if item is None:
            self._text.add(f"{event.text} ", start, end)
        else:
            first = item.first / SAMPLE_RATE_HZ
            item.text.add(f"{event.text} ", start - first, end - first)
            await self._send_chunks(item, (), avatar)

    # ---- interruptions

    async def _cut(self, avatar: Avatar | None, now: float, response: str | None = None) -> None:
        """The model stops: the user speaks, or a response is cancelled (this one, if it is named).

        If the client does not report what was heard, what was due by now counts, as if sound is played as it arrives.
        """
        playing = self.items.playing_at(now)
        if response is not None and playing is not None and playing.response_id not in (None, response):
            return
        name = response or self._response or (playing.response_id if playing else None)
        self._void = name, now if name or playing else -inf
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
        """Do not cut at the estimate; returns whether such a cut was pending."""
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
            self._void = self._void if self._void[0] or event.response_id else (None, now)
            self._awaited = "cancel" if self._awaited and event.type == "response.cancel" else self._awaited
        elif event.type == "session.update":
            self._update_session(event.session, is_wish=True)
        elif event.type == "response.create":
            self._asked_format, self._awaited = audio_format(event.response, "output"), "create"
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
