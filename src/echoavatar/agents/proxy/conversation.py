"""Turn Realtime events into messages of the avatar's session: the model's speech, the user's speech, interruptions.

Playback happens in the client, where the proxy cannot see it. The avatar's playhead follows the wall clock and is never
ahead of playback, because motion cannot exist before its sound. How much was heard is known from three sources: the
time at which sound was forwarded (a client plays it as it arrives), `conversation.item.truncate`, and
`echoavatar.played` from clients that know the proxy.
"""

import asyncio
from collections.abc import Iterable

import numpy as np

from echoavatar.timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize
from echoavatar.wire import Audio, Sound

from ..client import Avatar
from .events import AUDIO_DELTA, AUDIO_DONE, SESSION, Event, audio_format, inside, interrupts, sound
from .speech_items import Decoder, Pcm, SpeechItem, SpeechItems

GRACE_S = 0.25  # after the user starts to speak: time for the client to report how much was heard
TRUNCATE_TOLERANCE = SAMPLE_RATE_HZ // 30  # a truncation closer than this to the estimate changes nothing
USER_BLOCK = 24_000  # samples in one message


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
        """Handle an event of the model's."""
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
        if item.cut is None and not item.is_ended:
            await self._send_chunks(item, item.add(data), avatar)

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
        """Whether it is still open how much was heard."""
        return self._pending_cut is not None

    async def _truncate(self, event: Event, avatar: Avatar | None) -> None:
        """The client reports how much of an item was heard."""
        item = self.items.find(event.item_id, event.content_index or 0)
        if item is None or event.audio_end_ms is None:
            return
        heard = max(0, round(event.audio_end_ms * SAMPLE_RATE_HZ / 1000))
        estimate, item.cut = item.cut, heard
        self._cut_after(item)
        if self._pending_cut is not None:
            self._pending_cut.cancel()
            self._pending_cut = None
        elif estimate is not None and heard > estimate - TRUNCATE_TOLERANCE:
            return  # the avatar was cut there already
        if estimate is None and item.is_ended and heard >= item.samples:
            return  # all of it was heard
        if avatar is not None and item.seg:
            await avatar.interrupt(item.clock_at(heard))

    def _cut_after(self, item: SpeechItem) -> None:
        """Items that follow a truncated one will not be heard either."""
        is_after = False
        for other in self.items:
            if is_after and other.cut is None:
                other.cut = 0
            is_after = is_after or other is item

    # ---- the client

    async def on_client_event(self, event: Event, avatar: Avatar | None, now: float) -> None:
        """Handle an event of the client's."""
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
        samples = self._user_decoder[1].push(data)
        for start in range(0, len(samples), USER_BLOCK):
            block = samples[start : start + USER_BLOCK]
            await avatar.send(
                Audio(seg=self._user_segment, start=self._user_sent, pcm=block.astype("<i2").tobytes(), speaker="user")
            )
            self._user_sent += len(block)
