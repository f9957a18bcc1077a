"""ElevenLabs agents with a body: audio interfaces that put an avatar between the agent and the loudspeaker.

The SDK hands bytes to an audio interface without their format, which is a setting of the agent. So the caller states it
(`sample_rate`). The SDK does not report the end of an utterance either; a pause in the bytes marks it.
"""

import asyncio
import inspect
import json
import logging
import threading
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import soxr

from echoavatar.engine import Engine
from echoavatar.errors import AudioError, DependencyError, EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import BodyOptions

from ..timed_text import Word
from ..voice_formats import READABLE, Decoder, is_file, named_format
from .backend import find_backend
from .bridge import AvatarBridge
from .playback import AvatarChunk, Event
from .tools import AvatarTools

DEVICE_RATE = 16_000  # rate of the SDK's own interfaces, in both directions
PAUSE_S = 0.3  # without new bytes for this long, the utterance is over
RATES = (8_000, 16_000, 22_050, 24_000, 44_100, 48_000)
_Result = TypeVar("_Result")
_LOG = logging.getLogger(__name__)


try:
    from elevenlabs.conversational_ai.conversation import (
        AsyncAudioInterface,
        AudioEventAlignment,
        AudioInterface,
        ClientTools,
    )
except ModuleNotFoundError as error:
    raise DependencyError("the ElevenLabs SDK is missing: pip install 'elevenlabs>=2.40,<3'") from error


class AsyncAvatarAudioInterface(AsyncAudioInterface):  # type: ignore[misc]
    """For `AsyncConversation`. Plays through `device`, or without one through the avatar's page."""

    def __init__(
        self,
        where: str | Path | Engine = "default",
        *,
        sample_rate: int | str,
        device: Any = None,
        on_event: Callable[[Event], None] | None = None,
        token: str = "",
        seed: int = 0,
        body: BodyOptions | None = None,
        page_port: int | None = None,
    ) -> None:
        """Create the interface; `sample_rate` is the agent's output format, such as `ulaw_8000`, or the rate of PCM.

        `where` is a server's address, or a bundle's name or folder, or an engine, which then runs here; `page_port`
        serves its page. `device` is the microphone and loudspeaker: an audio interface of the SDK's kind, sync or
        async, at 16 kHz. `on_event` receives everything the avatar does, in order, motion included. `body`, such as
        `BodyOptions(leash_m=0.5)`, keeps the avatar near its place.

        Raises:
            AudioError: ElevenLabs has no such format, or it does not consist of samples.
            EchoAvatarError: the address is not valid.
        """
        self._kind, rate = named_format(f"pcm_{sample_rate}" if isinstance(sample_rate, int) else sample_rate)
        if rate not in RATES or str(rate) not in str(sample_rate) or self._kind not in READABLE:
            raise AudioError(
                f"sample_rate {sample_rate!r} is not supported; give ulaw_8000, or one of {', '.join(map(str, RATES))}"
            )
        self.bridge = AvatarBridge(find_backend(where, token=token, port=page_port), seed=seed, body=body)
        self._rate, self._device, self._on_event = rate, device, on_event
        self._decoder = Decoder(self._kind)
        self._has_told = False  # whether the log says that the agent sends files
        self._down: Any = soxr.ResampleStream(SAMPLE_RATE_HZ, DEVICE_RATE, 1, dtype="int16")
        self._speech: asyncio.Queue[bytes | AudioEventAlignment] = asyncio.Queue()
        self._tasks: list[asyncio.Task[None]] = []
        self._tools: AvatarTools | None = None
        self._has_failed = False

    @property
    def page(self) -> str:
        """Address of a page that shows the avatar; empty if there is none."""
        return self.bridge.page

    async def prepare(self) -> AvatarTools:
        """Open the session; returns the avatar's tools."""
        await self.bridge.start()
        if self._tools is None:
            self._tools = AvatarTools(self.bridge, await self.bridge.backend.tools())
        return self._tools

    async def register(self, client_tools: ClientTools) -> tuple[str, ...]:
        """Register the avatar's tools with the agent's client tools; returns their names."""
        tools, loop = await self.prepare(), asyncio.get_running_loop()  # the SDK may call from another loop

        def handler(name: str) -> Callable[[dict[str, Any]], Awaitable[str]]:
            async def handle(parameters: dict[str, Any]) -> str:
                arguments = {key: value for key, value in parameters.items() if key != "tool_call_id"}
                calling = asyncio.run_coroutine_threadsafe(tools.call(name, arguments), loop)
                return json.dumps(await asyncio.wrap_future(calling))

            return handle

        for name in tools.names:
            client_tools.register(name, handler(name), is_async=True)
        return tools.names

    # ---- called by the SDK

    async def start(self, input_callback: Callable[[bytes], Awaitable[None]]) -> None:
        """Start the conversation."""
        await self.prepare()
        self._tasks = [asyncio.ensure_future(self._speak()), asyncio.ensure_future(self._perform())]
        if self._device is not None:
            loop = asyncio.get_running_loop()

            async def hear(audio: bytes) -> None:
                await input_callback(audio)
                if not self._has_failed:
                    await self._try(self.bridge.hear_user(np.frombuffer(audio, "<i2"), DEVICE_RATE))

            def hear_in_thread(audio: bytes) -> None:
                asyncio.run_coroutine_threadsafe(hear(audio), loop)

            is_async = inspect.iscoroutinefunction(self._device.start)
            await _maybe(self._device.start(hear if is_async else hear_in_thread))

    async def stop(self) -> None:
        """End the conversation."""
        if self._device is not None:
            await _maybe(self._device.stop())
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.bridge.close()

    async def output(self, audio: bytes) -> None:
        """Take speech of the agent; returns at once."""
        if is_file(audio) and not self._has_told:
            self._has_told = True
            _LOG.warning("the agent sends files, not samples; set its output format to pcm_%d", self._rate)
        self._speech.put_nowait(audio)

    async def align(self, alignment: AudioEventAlignment) -> None:
        """Take the letters of the newest speech and their times: give this as `callback_audio_alignment`."""
        self._speech.put_nowait(alignment)

    async def interrupt(self) -> None:
        """Stop speaking at once: the user spoke."""
        while not self._speech.empty():
            self._speech.get_nowait()
        self._decoder = Decoder(self._kind)  # drops half a sample that the old one may hold
        if self._device is not None:
            await _maybe(self._device.interrupt())
            self._down.clear()
        if self.bridge.is_busy and not self._has_failed:
            await self._try(self.bridge.interrupt())

    # ---- internals

    async def _speak(self) -> None:
        begun_s = 0.0  # where in its utterance the newest speech begins; times of its letters count from there
        while True:
            try:
                async with asyncio.timeout(PAUSE_S):
                    speech = await self._speech.get()
            except TimeoutError:
                if not self._has_failed:
                    await self._try(self.bridge.end())
                speech = await self._speech.get()
            if not isinstance(speech, bytes):
                if not self._has_failed:
                    await self._try(self.bridge.words(_timed(speech, begun_s)))
                continue
            begun_s = self.bridge.said_s
            pcm = self._decoder.push(speech)
            if self._has_failed or not await self._try(self.bridge.say(pcm, self._rate)):
                await self._play(pcm, self._rate)  # the voice continues without the avatar

    async def _perform(self) -> None:
        try:
            async for event in self.bridge:
                if self._on_event is not None:
                    self._on_event(event)
                if isinstance(event, AvatarChunk) and event.pcm:
                    await self._play(np.frombuffer(event.pcm, "<i2"), SAMPLE_RATE_HZ)
        except EchoAvatarError:
            self._has_failed = True

    async def _play(self, pcm: np.ndarray[Any, Any], rate: int) -> None:
        if self._device is None:
            return
        if rate == SAMPLE_RATE_HZ:
            pcm = self._down.resample_chunk(pcm)
        elif rate != DEVICE_RATE:
            pcm = soxr.resample(pcm, rate, DEVICE_RATE)
        await _maybe(self._device.output(pcm.astype("<i2").tobytes()))

    async def _try(self, work: Awaitable[object]) -> bool:
        try:
            await work
        except EchoAvatarError:
            self._has_failed = True
        return not self._has_failed


class AvatarAudioInterface(AudioInterface):  # type: ignore[misc]
    """For `Conversation`, which calls back from threads: the same interface on an event loop of its own."""

    def __init__(self, where: str | Path | Engine = "default", **options: Any) -> None:
        """As `AsyncAvatarAudioInterface`; `device` may be `DefaultAudioInterface()`."""
        self.avatar = AsyncAvatarAudioInterface(where, **options)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="echoavatar audio", daemon=True)
        self._thread.start()

    @property
    def page(self) -> str:
        """Address of a page that shows the avatar, once `prepare` was called."""
        return self.avatar.page

    def prepare(self) -> AvatarTools:
        """Open the session; returns the avatar's tools."""
        return self._run(self.avatar.prepare())

    def register(self, client_tools: ClientTools) -> tuple[str, ...]:
        """Register the avatar's tools with the agent's client tools; returns their names."""
        return self._run(self.avatar.register(client_tools))

    def start(self, input_callback: Callable[[bytes], None]) -> None:
        """Start the conversation."""

        async def hear(audio: bytes) -> None:
            await asyncio.to_thread(input_callback, audio)  # the callback writes to a socket

        self._run(self.avatar.start(hear))

    def stop(self) -> None:
        """End the conversation."""
        self._run(self.avatar.stop())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def output(self, audio: bytes) -> None:
        """Take speech of the agent."""
        self._run(self.avatar.output(audio))

    def align(self, alignment: AudioEventAlignment) -> None:
        """Take the letters of the newest speech and their times: give this as `callback_audio_alignment`."""
        self._run(self.avatar.align(alignment))

    def interrupt(self) -> None:
        """Stop speaking at once: the user spoke."""
        self._run(self.avatar.interrupt())

    def _run(self, work: Coroutine[Any, Any, _Result]) -> _Result:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()


def _timed(alignment: AudioEventAlignment, begun_s: float) -> Iterator[Word]:
    """The letters of speech that begins at `begun_s`."""
    times = zip(alignment.chars, alignment.char_start_times_ms, alignment.char_durations_ms, strict=False)
    for char, start_ms, duration_ms in times:
        start_s = begun_s + start_ms / 1000
        yield char, start_s, start_s + duration_ms / 1000


async def _maybe(result: object) -> None:
    if inspect.isawaitable(result):
        await result
