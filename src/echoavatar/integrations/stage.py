"""An avatar behind a voice agent's framework: speech goes in as fast as it comes, hops of motion and sound come out.

A hop leaves only when its motion exists and shortly before it is due (`LEAD_S`), so that a framework's own queue never
holds much that an interruption or a new gesture makes void. What every framework does differently - how sound is
played, where motion goes, how it says what was heard - stays with its adapter. All methods are for one event loop.
"""

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Coroutine
from contextlib import suppress
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Shaped

from ..client import Avatar
from ..errors import EchoAvatarError
from ..timing import SAMPLE_RATE_HZ
from ..wire import (
    ActionStatus,
    Audio,
    Error,
    Flush,
    Hello,
    Motion,
    Ready,
    ServerMessage,
    Sound,
    State,
)
from .hop import Cut, Event, Hop, Said, make_hop
from .place import Place
from .playback import Playback
from .rate import Rate

LEAD_S = (
    0.25  # a hop leaves so long before it is due: less than the chunk that motion made again begins after
)
REPORT_S = 0.2
ANSWER_S = 5.0  # a server that is well answers sooner
_BEAT_S = 0.01


class Stage:
    """One session at a place, as a framework's adapter needs it."""

    def __init__(self, place: Place, *, seed: int = 0, lead_s: float = LEAD_S) -> None:
        self.place = place
        self.playback = Playback(0, 0.0)
        self._seed, self._lead = seed, round(lead_s * SAMPLE_RATE_HZ)
        self._avatar: Avatar | None = None
        self._events: deque[Event] = deque()
        self._filled = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._error: BaseException | None = None
        self._motion: Motion | None = None  # whose sound did not come yet
        self._left = 0  # clock up to which sound left
        self._end = 0  # clock up to which there are hops
        self._shift = 0  # our clock less that of the session, after one was lost and another goes on
        self._interrupted: asyncio.Future[Flush] | None = None
        self._asked: dict[str, asyncio.Future[ActionStatus]] = {}
        self._mouth, self._ear = Rate(), Rate()
        self._is_speaking, self._is_unsaid = False, False  # an utterance is open; one did not leave yet
        self._seg, self._cut_seg = 0, 0  # the newest utterance, the newest that was cut off
        self._heard_of_user = 0
        self._closed = False

    # ---- coming and going

    async def start(self) -> Ready:
        """Begin the session.

        Raises:
            EchoAvatarError: there is no server, no bundle or no seat.
        """
        if self._avatar is None:
            avatar = await self.place.open(Hello(seed=self._seed))
            self._avatar = avatar
            self._begin(avatar.ready)
            for task in (self._read(avatar), self._report(), avatar.keep_alive()):
                self._keep(task)
        return self._avatar.ready

    async def close(self) -> None:
        """End the session and leave the place; may be called twice."""
        self._closed = True
        self._filled.set()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        avatar, self._avatar = self._avatar, None
        if avatar is not None:
            await avatar.close()
            await self.place.close()

    @property
    def ready(self) -> Ready:
        """What the session said of itself."""
        return self._there.ready

    @property
    def page(self) -> str:
        """Address of a page that shows this session; empty where the place has none."""
        return self.place.page(self.ready.session)

    @property
    def is_busy(self) -> bool:
        """Whether there is anything to interrupt: speech that waits, or sound that left and may not be heard yet."""
        has_sound = any(isinstance(event, Hop) and event.pcm for event in self._events)
        return self._is_speaking or self._is_unsaid or has_sound or self.playback.is_sounding

    # ---- what the agent does

    async def say(self, pcm: Shaped[np.ndarray, " s"], rate: int) -> int:
        """Speak, int16 mono at any rate; returns the utterance's number. It goes on until `end`."""
        self._is_speaking = self._is_unsaid = True
        self._seg = await self._there.speak(self._mouth.push(pcm, rate), end=False)
        return self._seg

    async def end(self) -> int:
        """The utterance is complete; returns its number, 0 where there was none."""
        if not self._is_speaking:
            return 0
        self._is_speaking = False
        return await self._there.speak(self._mouth.flush(), end=True)

    async def interrupt(self) -> Flush | None:
        """Barge-in: what was not heard never was. Nothing stale leaves from now on.

        Returns where the session was cut (`flush.heard` samples of utterance `flush.seg` were heard), or None where
        the line broke meanwhile. Calls that come together share one cut.
        """
        self._is_speaking = self._is_unsaid = False
        self._mouth.reset()
        if self._interrupted is None:
            heard = self.playback.position(time.monotonic())
            self._interrupted = asyncio.get_running_loop().create_future()
            self._motion, self._cut_seg = None, self._seg
            self._events = deque(event for event in self._events if not isinstance(event, Hop | Said))
            self.playback.jump(heard, time.monotonic())
            await self._there.interrupt(max(0, heard - self._shift))
        with suppress(TimeoutError):
            return await asyncio.wait_for(asyncio.shield(self._interrupted), ANSWER_S)
        return None

    async def hear_user(self, pcm: Shaped[np.ndarray, " s"], rate: int) -> None:
        """The user speaks, int16 mono at any rate: the avatar listens to them."""
        samples = self._ear.push(pcm, rate)
        if len(samples):
            start, self._heard_of_user = self._heard_of_user, self._heard_of_user + len(samples)
            pcm_bytes = samples.astype("<i2").tobytes()
            await self._there.send(Audio(seg=1, start=start, pcm=pcm_bytes, speaker="user"))

    async def act(self, name: str, *, intensity: float = 1.0, hold: float | None = None) -> ActionStatus:
        """Ask for an action; whether it was accepted."""
        return await self._answer(await self._there.act(name, intensity=intensity, hold=hold))

    async def play_music(self, title: str = "") -> ActionStatus:
        """Play a track: the avatar dances to it, and hops carry it. Whether there is such a one."""
        return await self._answer(await self._there.play_music(title))

    async def stop_music(self) -> None:
        """Fade it out."""
        await self._there.stop_music()

    # ---- what comes of it

    async def __aiter__(self) -> AsyncIterator[Event]:
        """Everything in order, each hop when it is due, until the session is closed.

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
            if isinstance(event, Hop):
                if event.at - self.playback.position(time.monotonic()) > self._lead:
                    await asyncio.sleep(_BEAT_S)
                    continue
                self._let_go(event)
            self._events.popleft()
            if isinstance(event, Said) and event.seg >= self._seg:
                self._is_unsaid = False
            yield event

    # ---- inside

    @property
    def _there(self) -> Avatar:
        if self._avatar is None:
            raise EchoAvatarError("this session is not open; await start() first")
        return self._avatar

    def _keep(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _let_go(self, hop: Hop) -> None:
        samples = hop.motion.frames * SAMPLE_RATE_HZ // self.ready.frame_rate
        if hop.at + samples > self._left:
            self.playback.pushed(hop.at, samples, audible=bool(hop.pcm))
            self._left = hop.at + samples

    def _begin(self, ready: Ready) -> None:
        """A session began, or goes on; where one was lost, the next goes on at the end of what came of it."""
        if not ready.resumed:
            if self._left == 0:
                self.playback = Playback(ready.at, time.monotonic())
                self._left = self._end = ready.at
            self._shift = self._end - ready.at
            self._motion, self._heard_of_user = None, 0
            if self._interrupted is not None and not self._interrupted.done():
                self._interrupted.cancel()
            self._interrupted = None
        self._put(msgspec.structs.replace(ready, at=ready.at + self._shift))

    async def _read(self, avatar: Avatar) -> None:
        try:
            async for message in avatar:
                self._take(message)
            self._error = self._error or EchoAvatarError("the server ended the session")
        except Exception as error:
            self._error = error
        self._filled.set()

    def _take(self, message: ServerMessage) -> None:
        if self._shift and isinstance(message, Motion | Sound | Flush | State | ActionStatus):
            message = msgspec.structs.replace(message, at=message.at + self._shift)
        match message:
            case Ready():
                self._begin(message)
            case Motion() if self._interrupted is None:
                self._motion = message
            case Sound() if self._interrupted is None:
                self._pair(message)
            case Flush():
                self._cut(message)
            case ActionStatus():
                self._put(message)
                if (waiting := self._asked.pop(message.id, None)) is not None and not waiting.done():
                    waiting.set_result(message)
            case State():
                self._put(message)
                if message.finished and self._interrupted is None:
                    self._put(Said(message.finished, message.at))
            case Error(fatal=True):
                self._error = EchoAvatarError(message.message)

    def _pair(self, sound: Sound) -> None:
        """A hop, when both halves are here; a slow line may have lost motion, never sound."""
        motion, self._motion = self._motion, None
        self._end = max(self._end, sound.at + len(sound.pcm) // 2)
        self._put(make_hop(motion, sound, left=self._left, cut_seg=self._cut_seg))

    def _cut(self, flush: Flush) -> None:
        asked, self._interrupted = self._interrupted, None
        self._motion = None
        kept = (event for event in self._events if not isinstance(event, Hop) or event.at < flush.at)
        self._events = deque(kept)
        if asked is not None:
            self._left, self._end = min(self._left, flush.at), flush.at
            self.playback.jump(flush.at, time.monotonic())
            if not asked.done():
                asked.set_result(flush)
        self._put(Cut(flush, asked is not None))

    def _put(self, event: Event) -> None:
        self._events.append(event)
        self._filled.set()

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(REPORT_S)
            if self._interrupted is None:
                position = self.playback.position(time.monotonic())
                await self._there.played(max(0, position - self._shift))

    async def _answer(self, id: str) -> ActionStatus:
        waiting: asyncio.Future[ActionStatus] = asyncio.get_running_loop().create_future()
        self._asked[id] = waiting
        try:
            return await asyncio.wait_for(waiting, ANSWER_S)
        except TimeoutError:
            self._asked.pop(id, None)
            return ActionStatus(
                id=id, name="", status="rejected", at=0, reason="the avatar did not answer", choices=()
            )
