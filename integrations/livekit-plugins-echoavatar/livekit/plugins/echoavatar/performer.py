"""Connect an agent's voice to a room: speech in from LiveKit's audio receivers, sound and motion out, in sync.

The receiver is told what really happened: playback starts when the first sample leaves the source's queue, and ends or
is cut at the sample that was heard. Music is part of the published sound, so the avatar dances to what it hears.
"""

import asyncio
import time
from collections import deque
from dataclasses import dataclass
from math import nan
from typing import Protocol

from livekit import rtc
from livekit.agents import utils
from livekit.agents.types import USERDATA_TIMED_TRANSCRIPT, TimedString
from livekit.agents.voice.avatar import AudioReceiver, AudioSegmentEnd

from echoavatar.agents.integrations import AvatarBridge, AvatarChunk, Flushed, UtteranceDone
from echoavatar.agents.timed_text import Word
from echoavatar.errors import EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import Flush, Ready

from .film import Film
from .log import logger
from .motion import MotionChannel

POLL_S = 0.02
QUEUE_MS = 1_000  # length of the source's queue; the bridge fills at most half of it


class Source(Protocol):
    """What plays the sound: `rtc.AudioSource`."""

    @property
    def queued_duration(self) -> float:
        """Seconds of sound that wait to be played."""

    async def capture_frame(self, frame: rtc.AudioFrame) -> None:
        """Queue a frame of sound."""

    def clear_queue(self) -> None:
        """Drop everything that waits to be played."""


@dataclass
class Segment:
    """A stretch of speech between two segment ends, as LiveKit counts playback."""

    seg: int = 0  # its utterance
    seconds: float = 0.0  # length of the speech from the agent
    starts: int | None = None  # clock of its first chunk
    ends: int | None = None  # clock of its last sample, once it was released completely
    is_started: bool = False  # and the agent was told so


class Performer:
    """Runs one avatar for one audio receiver."""

    def __init__(
        self,
        bridge: AvatarBridge,
        receiver: AudioReceiver,
        source: Source,
        channel: MotionChannel,
        film: Film | None = None,
    ) -> None:
        """`film` is shown what the channel is; it is then the source, too."""
        self.bridge, self._film = bridge, film
        self._receiver, self._source, self._channel = receiver, source, channel
        self._segments: deque[Segment] = deque()
        self._is_open = False  # whether the newest segment is still growing
        self._captured = 0  # clock at the end of the newest sound in the source
        self._tasks: list[asyncio.Task[None]] = []
        self._clearing: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Start. The receiver may have to wait for its sender."""
        await self.bridge.start()
        await self._channel.start()
        self._receiver.on("clear_buffer", self._clear)
        await self._receiver.start()
        self._tasks = [asyncio.ensure_future(work) for work in (self._listen(), self._perform(), self._watch())]

    async def close(self) -> None:
        """End the session."""
        self._receiver.off("clear_buffer", self._clear)
        for task in [*self._tasks, *self._clearing]:
            task.cancel()
        await asyncio.gather(*self._tasks, *self._clearing, return_exceptions=True)
        await self._channel.close()
        await self.bridge.close()

    def greet(self, identity: str) -> None:
        """Describe the rig to a participant who joined the room."""
        self._channel.tell(self.bridge.ready, to=identity)

    # ---- speech in

    async def _listen(self) -> None:
        async for item in self._receiver:
            try:
                if isinstance(item, AudioSegmentEnd):
                    await self._end()
                else:
                    await self._say(item)
            except EchoAvatarError as error:
                logger.error("the avatar is gone: %s", error)

    async def _say(self, frame: rtc.AudioFrame) -> None:
        if not self._is_open:
            self._is_open = True
            self._segments.append(Segment())
        segment = self._segments[-1]
        segment.seconds += frame.duration
        await self.bridge.words(_timed(text) for text in frame.userdata.get(USERDATA_TIMED_TRANSCRIPT, ()))
        segment.seg = await self.bridge.say(bytes(frame.data), frame.sample_rate, frame.num_channels)

    async def _end(self) -> None:
        if self._is_open:
            self._is_open = False
            await self.bridge.end()

    # ---- sound and motion out

    async def _perform(self) -> None:
        try:
            async for event in self.bridge:
                match event:
                    case AvatarChunk():
                        await self._show(event)
                    case UtteranceDone():
                        for segment in self._segments:
                            if segment.seg and segment.seg <= event.seg and segment.ends is None:
                                segment.ends = event.at
                    case Flushed():
                        if self._film is not None:
                            self._film.flush(event.flush)
                        self._channel.tell(event.flush)
                    case Ready():
                        self._channel.tell(event)
                    case _:
                        self._channel.tell(event)
        except EchoAvatarError as error:
            logger.error("the avatar is gone: %s", error)
            for _ in range(len(self._segments)):  # otherwise the agent would wait for ever
                segment = self._segments.popleft()
                self._finished(segment.seconds, interrupted=True)

    async def _show(self, chunk: AvatarChunk) -> None:
        if chunk.pcm and self._film is None:  # after silence nothing waits in the source, which then plays at once
            due = self._source.queued_duration
        else:
            due = (chunk.at - self.bridge.playback.position(time.monotonic())) / SAMPLE_RATE_HZ
        self._channel.show(chunk.motion, due_s=due)
        if self._film is not None:
            self._film.take(chunk)
        if not chunk.pcm:
            return
        for segment in self._segments:
            if segment.seg == chunk.seg and segment.starts is None:
                segment.starts = chunk.at
        self._captured = chunk.at + len(chunk.pcm) // 2
        await self._source.capture_frame(
            rtc.AudioFrame(chunk.pcm, SAMPLE_RATE_HZ, num_channels=1, samples_per_channel=len(chunk.pcm) // 2)
        )

    # ---- reports to the agent

    def _sync(self) -> int:
        """The listener's position: exact while sound waits in the source's queue, else estimated."""
        now, queued = time.monotonic(), self._source.queued_duration
        if queued > 0 and self.bridge.playback.end >= self._captured:
            self.bridge.playback.plays(self._captured - round(queued * SAMPLE_RATE_HZ), now)
        return self.bridge.playback.position(now)

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(POLL_S)
            position = self._sync()
            for segment in self._segments:
                if not segment.is_started and segment.starts is not None and position >= segment.starts:
                    self._started(segment)
            while self._segments and (ends := self._segments[0].ends) is not None and position >= ends:
                segment = self._segments.popleft()
                self._started(segment)
                self._finished(segment.seconds, interrupted=False)

    def _clear(self, *_: object) -> None:
        """The agent was interrupted: silence the avatar at once, then report what was heard."""
        self._sync()
        lost, self._segments, self._is_open = list(self._segments), deque(), False
        if not lost and not self.bridge.is_busy:
            return
        task = asyncio.ensure_future(self._cut(lost))
        self._clearing.add(task)
        task.add_done_callback(self._clearing.discard)

    async def _cut(self, lost: list[Segment]) -> None:
        try:
            interrupting = asyncio.ensure_future(self.bridge.interrupt())
            await asyncio.sleep(0)  # from here on no stale chunk is released
            self._source.clear_queue()
            flush = await interrupting
        except EchoAvatarError as error:
            logger.error("the avatar is gone: %s", error)
            flush = None
        for segment in lost:
            self._finished(_heard(segment, flush), interrupted=True)

    def _started(self, segment: Segment) -> None:
        if not segment.is_started:
            segment.is_started = True
            self._receiver.notify_playback_started()

    def _finished(self, seconds: float, *, interrupted: bool) -> None:
        self._receiver.notify_playback_finished(playback_position=seconds, interrupted=interrupted)


def _timed(text: TimedString) -> Word:
    """A piece of text whose times count from the first sample of its segment."""
    start, end = (at if utils.is_given(at) else nan for at in (text.start_time, text.end_time))
    return text, start, end


def _heard(segment: Segment, flush: Flush | None) -> float:
    """Seconds of a segment that were heard before a cut."""
    if flush is None or not segment.seg or segment.seg > flush.seg > 0:
        return 0.0
    if segment.seg == flush.seg:
        return min(segment.seconds, flush.heard / SAMPLE_RATE_HZ)
    return segment.seconds  # the cut came after the segment
