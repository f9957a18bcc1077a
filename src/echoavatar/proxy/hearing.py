"""Realtime events to the avatar's session: what is said, what the user says, and where someone was cut off.

Playback happens in the client, out of sight. The avatar's playhead goes by the wall clock and is never ahead of it, as
motion cannot be there before its sound. What was heard is known from when sound was passed on (a client plays it as it
comes), from `conversation.item.truncate`, and from clients that know us: `echoavatar.played`.
"""

import asyncio
from collections.abc import Iterable

import numpy as np

from ..client import Avatar
from ..timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize
from ..wire import Audio, Sound
from .decoder import Decoder, Pcm
from .events import AUDIO_DELTA, AUDIO_DONE, SESSION, Event, audio_format, inside, interrupts, sound
from .voices import Voice, Voices

GRACE_S = 0.25  # after the user began to speak, for the client to say how much was heard
EXACTER = SAMPLE_RATE_HZ // 30  # a truncation closer than this to what was assumed changes nothing
USER_BLOCK = 24_000  # samples in one message


class Hearing:
    """What one conversation has said so far, and where on the avatar's clock it lies."""

    def __init__(self) -> None:
        self.voices = Voices()
        self._chunk = CHUNK
        self._format = {"input": ("pcm", SAMPLE_RATE_HZ), "output": ("pcm", SAMPLE_RATE_HZ)}
        self._response_format: tuple[str, int] | None = None
        self._is_cut_by_user = True
        self._ear: tuple[tuple[str, int], Decoder] | None = None
        self._user_seg, self._user_sent = 0, 0
        self._grace: asyncio.Task[None] | None = None

    # ---- the avatar's session

    def begin(self, chunk: ChunkSize = CHUNK) -> None:
        """The avatar is there, or there again, and steps by such chunks; what was said before is not said again."""
        self._chunk = chunk
        self._user_seg, self._user_sent = self._user_seg + 1, 0

    def lose(self) -> None:
        """The avatar that knew all this is gone."""
        if self._grace is not None:
            self._grace.cancel()
            self._grace = None
        self.voices.forget()

    def note(self, message: Sound) -> None:
        """Sound came back: the piece of an item that lies there. Before anything is made of it."""
        voice = self.voices.of(message.seg)
        if voice is not None:
            voice.came_back(message.at)

    # ---- the model

    async def server_says(self, event: Event, avatar: Avatar | None, now: float) -> None:
        """An event of the model's."""
        if event.type in AUDIO_DELTA:
            await self._speak(event, avatar, now)
        elif event.type in AUDIO_DONE:
            await self._end(self.voices.find(event.item_id, event.content_index or 0), avatar)
        elif event.type == "response.created":
            self._response_format = audio_format(event.response, "output")
        elif event.type == "response.done":
            for voice in self.voices:
                if voice.response_id == inside(event.response, "id"):
                    await self._end(voice, avatar)
        elif event.type in SESSION:
            self._learn(event.session)
        elif event.type == "input_audio_buffer.speech_started" and self._is_cut_by_user:
            self._cut_all(avatar, now)

    def _learn(self, session: object) -> None:
        for direction in ("input", "output"):
            self._format[direction] = audio_format(session, direction) or self._format[direction]
        told = interrupts(session)
        self._is_cut_by_user = self._is_cut_by_user if told is None else told

    async def _speak(self, event: Event, avatar: Avatar | None, now: float) -> None:
        data = sound(event.delta)
        if not data or event.item_id is None:
            return
        voice = self.voices.find(event.item_id, event.content_index or 0)
        if voice is None:
            await self._end(self.voices.newest, avatar)
            voice = Voice(
                item_id=event.item_id,
                response_id=event.response_id,
                output_index=event.output_index or 0,
                content_index=event.content_index or 0,
                decoder=Decoder(*(self._response_format or self._format["output"])),
                begun=now,
                chunk=self._chunk,
            )
            if avatar is None:
                voice.cut = 0  # its beginning was missed: the body stays at rest for it
            self.voices.begin(voice)
        if voice.cut is None and not voice.is_ended:
            await self._hand_over(voice, voice.add(data), avatar)

    async def _end(self, voice: Voice | None, avatar: Avatar | None) -> None:
        if voice is None or voice.is_ended:
            return
        chunks = voice.end()
        if voice.cut is None:
            await self._hand_over(voice, chunks, avatar)
            if avatar is not None and voice.seg:
                await avatar.speak(np.zeros(0, np.int16))

    async def _hand_over(self, voice: Voice, chunks: Iterable[Pcm], avatar: Avatar | None) -> None:
        for chunk in chunks:
            if avatar is not None and voice.cut is None:
                voice.seg = await avatar.speak(chunk, end=False)

    # ---- interruptions

    def _cut_all(self, avatar: Avatar | None, now: float) -> None:
        """The user speaks: the model falls silent. Clients say in a moment how much was heard; else it is assumed."""
        voice = self.voices.heard_now(now)
        for other in self.voices:
            if other.cut is None and not (other.is_ended and other.heard(now) >= other.samples):
                other.cut = other.heard(now)
        if voice is None or avatar is None:
            return
        at = voice.clock_at(voice.heard(now))

        async def assume() -> None:
            await asyncio.sleep(GRACE_S)
            self._grace = None
            await avatar.interrupt(at)

        self._grace = asyncio.create_task(assume())

    @property
    def is_cutting(self) -> bool:
        """Whether it is not known yet how much was heard."""
        return self._grace is not None

    async def _truncate(self, event: Event, avatar: Avatar | None) -> None:
        """The client knows how much of an item was heard."""
        voice = self.voices.find(event.item_id, event.content_index or 0)
        if voice is None or event.audio_end_ms is None:
            return
        heard = max(0, round(event.audio_end_ms * SAMPLE_RATE_HZ / 1000))
        assumed, voice.cut = voice.cut, heard
        self._cut_after(voice)
        if self._grace is not None:
            self._grace.cancel()
            self._grace = None
        elif assumed is not None and heard > assumed - EXACTER:
            return  # it was cut there already
        if assumed is None and voice.is_ended and heard >= voice.samples:
            return  # all of it was heard
        if avatar is not None and voice.seg:
            await avatar.interrupt(voice.clock_at(heard))

    def _cut_after(self, voice: Voice) -> None:
        """What was to follow a truncated item will not be heard either."""
        is_after = False
        for other in self.voices:
            if is_after and other.cut is None:
                other.cut = 0
            is_after = is_after or other is voice

    # ---- the client

    async def client_says(self, event: Event, avatar: Avatar | None, now: float) -> None:
        """An event of the client's."""
        if event.type == "input_audio_buffer.append":
            await self._listen(sound(event.audio), avatar)
        elif event.type == "conversation.item.truncate":
            await self._truncate(event, avatar)
        elif event.type == "echoavatar.played" and event.audio_end_ms is not None:
            voice = self.voices.find(event.item_id, event.content_index or 0)
            if voice is not None:
                voice.begun = now - event.audio_end_ms / 1000

    async def _listen(self, data: bytes, avatar: Avatar | None) -> None:
        """The user's voice: the avatar looks at who speaks, and nods."""
        if not data or avatar is None:
            return
        form = self._format["input"]
        if self._ear is None or self._ear[0] != form:
            self._ear = (form, Decoder(*form))
        samples = self._ear[1].push(data)
        for start in range(0, len(samples), USER_BLOCK):
            block = samples[start : start + USER_BLOCK]
            await avatar.send(
                Audio(
                    seg=self._user_seg,
                    start=self._user_sent,
                    pcm=block.astype("<i2").tobytes(),
                    speaker="user",
                )
            )
            self._user_sent += len(block)
