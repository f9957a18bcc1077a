"""An avatar behind a voice agent's framework: speech in, motion and sound out.

A chunk is released only when its motion exists, and shortly before it is due (`LEAD_S`). So a framework's queue never
holds much that an interruption or a new gesture would invalidate. What differs between frameworks stays in their
adapters: how sound is played, where motion goes, and how playback is reported. Call all methods from one event loop.
"""

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Iterable
from contextlib import suppress

import msgspec
import numpy as np

from echoavatar.agents.client import Avatar
from echoavatar.errors import EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import (
    ActionStatus,
    Audio,
    BodyOptions,
    Error,
    Flush,
    Hello,
    Motion,
    Ready,
    ServerMessage,
    Sound,
    State,
)

from ..timed_text import TimedText, Word
from ..voice_formats import Decoder, Pcm
from .backend import AvatarBackend
from .playback import AvatarChunk, Event, Flushed, Playback, UtteranceDone, make_chunk

LEAD_S = 0.25  # a chunk is released this long before it is due: less than the lead of remade motion
REPORT_S = 0.2
REPLY_TIMEOUT_S = 5.0  # a healthy server answers sooner
_POLL_S = 0.01
Speech = np.ndarray | bytes | bytearray | memoryview  # int16, channels interleaved; bytes may end within a sample


class SpeechResampler:
    """Resamples one stream of an agent's speech from any rate to the session's, without a seam between blocks."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Drop samples that the resampler still holds."""
        self._form, self._decoder = (SAMPLE_RATE_HZ, 1), Decoder()

    def push(self, pcm: Speech, rate: int, channels: int = 1) -> Pcm:
        """Resample a block; some of its samples may come out with the next block.

        A block of bytes may end within a sample; the next block then begins with the rest of it.
        """
        if (rate, channels) != self._form:
            self._form, self._decoder = (rate, channels), Decoder("pcm", rate, channels)
        return self._decoder.push(pcm.astype("<i2").tobytes() if isinstance(pcm, np.ndarray) else bytes(pcm))

    def flush(self) -> Pcm:
        """The rest of the stream; the next block starts another one."""
        rest = self._decoder.push(b"", is_last=True)
        self.reset()
        return rest


class AvatarBridge:
    """One avatar session in the form that a framework's adapter needs."""

    def __init__(self, backend: AvatarBackend, *, seed: int = 0, body: BodyOptions | None = None) -> None:
        """`body` says how far the avatar may walk, such as `BodyOptions(leash_m=0.5)`; by default anywhere."""
        self.backend = backend
        self.playback = Playback(0, 0.0)
        self.said_s = 0.0  # seconds of speech in the open utterance
        self._hello = Hello(seed=seed, body=body or BodyOptions())
        self._avatar: Avatar | None = None
        self._events: deque[Event] = deque()
        self._filled = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self._error: BaseException | None = None
        self._motion: Motion | None = None  # motion whose sound has not arrived
        self._released_to = 0  # clock up to which sound was released
        self._received_to = 0  # clock up to which chunks have arrived
        self._clock_offset = 0  # bridge's clock minus session's; not 0 after a lost session was replaced
        self._pending_flush: asyncio.Future[Flush] | None = None
        self._agent_resampler, self._user_resampler = SpeechResampler(), SpeechResampler()
        self._text = TimedText()  # of the open utterance, or of the next one
        self._is_speaking = False  # whether an utterance is open
        self._has_unreleased_speech = False
        self._seg, self._cut_seg = 0, 0  # the newest utterance; the newest that was cut off
        self._user_samples = 0
        self._closed = False

    # ---- start and end

    async def start(self) -> Ready:
        """Open the session.

        Raises:
            EchoAvatarError: there is no server, no bundle or no free seat.
        """
        if self._avatar is None:
            avatar = await self.backend.open(self._hello)
            self._avatar = avatar
            self._begin(avatar.ready)
            work = (self._read(avatar), self._report(), avatar.keep_alive())
            self._tasks = [asyncio.create_task(part) for part in work]
        return self._avatar.ready

    async def close(self) -> None:
        """End the session and close the backend; may be called twice."""
        self._closed = True
        self._filled.set()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        avatar, self._avatar = self._avatar, None
        if avatar is not None:
            await avatar.close()
            await self.backend.close()

    @property
    def ready(self) -> Ready:
        """What the session reported about itself."""
        return self._session.ready

    @property
    def page(self) -> str:
        """Address of a page that shows this session; empty if the backend has none."""
        return self.backend.page(self.ready.session)

    @property
    def is_busy(self) -> bool:
        """Whether there is anything to interrupt: speech not released yet, or sound that may still be playing."""
        has_sound = any(isinstance(event, AvatarChunk) and event.pcm for event in self._events)
        return self._is_speaking or self._has_unreleased_speech or has_sound or self.playback.is_sounding

    # ---- input

    async def say(self, pcm: Speech, rate: int, channels: int = 1) -> int:
        """Speak samples at any rate; returns the utterance's number. The utterance continues until `end`."""
        self._is_speaking = self._has_unreleased_speech = True
        self.said_s += (pcm.nbytes if isinstance(pcm, np.ndarray) else len(bytes(pcm))) / (2 * channels * rate)
        samples = self._agent_resampler.push(pcm, rate, channels)
        self._seg = await self._session.speak(samples, end=False, words=self._text.take())
        return self._seg

    async def words(self, text: Iterable[Word]) -> None:
        """Send timed text of the open utterance, or of the next one; see `Avatar.words`.

        Its pieces may be of any size, such as letters: words end at white space, and with the utterance.
        """
        for piece in text:
            self._text.add(*piece)
        if self._is_speaking and (words := self._text.take()):
            await self._session.words(words, seg=self._seg)

    async def end(self) -> int:
        """End the utterance; returns its number, or 0 if none is open."""
        if not self._is_speaking:
            return 0
        self._text.close()
        words = self._text.take()
        self._forget_utterance()
        return await self._session.speak(self._agent_resampler.flush(), end=True, words=words)

    async def interrupt(self) -> Flush | None:
        """Interrupt the avatar: discard what was not heard. From now on no stale chunk is released.

        Returns where the session was cut (`flush.heard` samples of utterance `flush.seg` were heard), or None if the
        connection broke meanwhile. Concurrent calls share one cut.
        """
        self._forget_utterance()
        self._has_unreleased_speech = False
        self._agent_resampler.reset()
        if self._pending_flush is None:
            heard = self.playback.position(time.monotonic())
            self._pending_flush = asyncio.get_running_loop().create_future()
            self._motion, self._cut_seg = None, self._seg
            self._events = deque(event for event in self._events if not isinstance(event, AvatarChunk | UtteranceDone))
            self.playback.jump(heard, time.monotonic())
            await self._session.interrupt(max(0, heard - self._clock_offset))
        with suppress(TimeoutError):
            return await asyncio.wait_for(asyncio.shield(self._pending_flush), REPLY_TIMEOUT_S)
        return None

    async def hear_user(self, pcm: Speech, rate: int, channels: int = 1) -> None:
        """Let the avatar listen to the user, at any rate."""
        samples = self._user_resampler.push(pcm, rate, channels)
        if len(samples):
            start, self._user_samples = self._user_samples, self._user_samples + len(samples)
            pcm_bytes = samples.astype("<i2").tobytes()
            await self._session.send(Audio(seg=1, start=start, pcm=pcm_bytes, speaker="user"))

    # ---- output

    async def __aiter__(self) -> AsyncIterator[Event]:
        """Yield all events in order, each chunk when it is due, until the session is closed.

        Raises:
            EchoAvatarError: the session was lost for good.
        """
        while not self._closed:
            if not self._events:
                if self._error is not None:
                    raise EchoAvatarError(f"the avatar is gone: {self._error}") from self._error
                self._filled.clear()
                await self._filled.wait()
                continue
            event = self._events[0]
            if isinstance(event, AvatarChunk):
                if event.at - self.playback.position(time.monotonic()) > LEAD_S * SAMPLE_RATE_HZ:
                    await asyncio.sleep(_POLL_S)
                    continue
                self._release(event)
            self._events.popleft()
            if isinstance(event, UtteranceDone) and event.seg >= self._seg:
                self._has_unreleased_speech = False
            yield event

    # ---- internals

    @property
    def _session(self) -> Avatar:
        if self._avatar is None:
            raise EchoAvatarError("the session is not open; await start() first")
        return self._avatar

    def _forget_utterance(self) -> None:
        self._is_speaking, self.said_s, self._text = False, 0.0, TimedText()

    def _release(self, chunk: AvatarChunk) -> None:
        samples = chunk.motion.frames * SAMPLE_RATE_HZ // self.ready.frame_rate
        if chunk.at + samples > self._released_to:
            self.playback.pushed(chunk.at, samples, audible=bool(chunk.pcm))
            self._released_to = chunk.at + samples

    def _begin(self, ready: Ready) -> None:
        """Use a new or resumed session. A session that replaces a lost one continues the clock where that one ended."""
        if not ready.resumed:
            if self._released_to == 0:
                self.playback = Playback(ready.at, time.monotonic())
                self._released_to = self._received_to = ready.at
            self._clock_offset = self._received_to - ready.at
            self._motion, self._user_samples = None, 0
            if self._pending_flush is not None and not self._pending_flush.done():
                self._pending_flush.cancel()
            self._pending_flush = None
        self._put(msgspec.structs.replace(ready, at=ready.at + self._clock_offset))

    async def _read(self, avatar: Avatar) -> None:
        try:
            async for message in avatar:
                self._take(message)
            self._error = self._error or EchoAvatarError("the server ended the session")
        except Exception as error:
            self._error = error
        self._filled.set()

    def _take(self, message: ServerMessage) -> None:
        if self._clock_offset and isinstance(message, Motion | Sound | Flush | State | ActionStatus):
            message = msgspec.structs.replace(message, at=message.at + self._clock_offset)
        match message:
            case Ready():
                self._begin(message)
            case Motion() if self._pending_flush is None:
                self._motion = message
            case Sound() if self._pending_flush is None:
                self._pair(message)
            case Flush():
                self._cut(message)
            case ActionStatus():
                self._put(message)
            case State():
                self._put(message)
                if message.finished and self._pending_flush is None:
                    self._put(UtteranceDone(message.finished, message.at))
            case Error(fatal=True):
                self._error = EchoAvatarError(message.message)

    def _pair(self, sound: Sound) -> None:
        """Build a chunk from sound and its motion; a slow connection may have dropped the motion, never the sound."""
        motion, self._motion = self._motion, None
        self._received_to = max(self._received_to, sound.at + len(sound.pcm) // 2)
        self._put(make_chunk(motion, sound, released_to=self._released_to, cut_seg=self._cut_seg))

    def _cut(self, flush: Flush) -> None:
        requested, self._pending_flush = self._pending_flush, None
        self._motion = None
        kept = (event for event in self._events if not isinstance(event, AvatarChunk) or event.at < flush.at)
        self._events = deque(kept)
        if requested is not None:
            self._released_to, self._received_to = min(self._released_to, flush.at), flush.at
            self.playback.jump(flush.at, time.monotonic())
            if not requested.done():
                requested.set_result(flush)
        self._put(Flushed(flush, requested is not None))

    def _put(self, event: Event) -> None:
        self._events.append(event)
        self._filled.set()

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(REPORT_S)
            if self._pending_flush is None:
                position = self.playback.position(time.monotonic())
                await self._session.played(max(0, position - self._clock_offset))
