"""ElevenLabs agents with a body: audio interfaces that put an avatar between the agent and the loudspeaker.

The SDK hands a third-party interface bytes and never says at what rate: the agent's own setting decides, so the rate is
asked for here (`sample_rate`), and bytes that cannot be of it are refused. The SDK does not say where an utterance ends
either; a pause in the bytes does.
"""

import asyncio
import inspect
import json
import threading
from collections.abc import Awaitable, Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import soxr

from ..engine import Engine
from ..errors import AudioError, DependencyError, EchoAvatarError
from ..timing import SAMPLE_RATE_HZ
from .hop import Event, Hop
from .place import find_place
from .stage import Stage
from .tools import StageTools

try:
    from elevenlabs.conversational_ai.conversation import AsyncAudioInterface, AudioInterface, ClientTools
except ModuleNotFoundError as error:
    raise DependencyError("the ElevenLabs SDK is missing: pip install 'elevenlabs>=2.40,<3'") from error

DEVICE_RATE = 16_000  # of the SDK's own interfaces, both ways
PAUSE_S = 0.3  # without bytes: the utterance is over
RATES = (8_000, 16_000, 22_050, 24_000, 44_100, 48_000)
_Result = TypeVar("_Result")


class AsyncAvatarAudioInterface(AsyncAudioInterface):  # type: ignore[misc]
    """For `AsyncConversation`: an avatar over a device, or over none where the avatar's page is the loudspeaker."""

    def __init__(
        self,
        where: str | Path | Engine = "default",
        *,
        sample_rate: int,
        device: Any = None,
        on_event: Callable[[Event], None] | None = None,
        token: str = "",
        seed: int = 0,
        page_port: int | None = None,
    ) -> None:
        """`sample_rate`: of the agent's output format, such as 16000 for `pcm_16000`.

        `where`: a server's address, or a bundle's name or folder, or an engine, to run here; `page_port`: its page.
        `device`: microphone and loudspeaker, an interface of the SDK's kind, sync or async, at 16 kHz.
        `on_event` is told everything the avatar does, motion included, in order.

        Raises:
            AudioError: no such rate.
        """
        if sample_rate not in RATES:
            raise AudioError(
                f"sample_rate {sample_rate}; ElevenLabs agents speak at {', '.join(map(str, RATES))}"
            )
        self.stage = Stage(find_place(where, token=token, port=page_port), seed=seed)
        self._rate, self._device, self._on_event = sample_rate, device, on_event
        self._down: Any = soxr.ResampleStream(SAMPLE_RATE_HZ, DEVICE_RATE, 1, dtype="int16")
        self._bytes: asyncio.Queue[bytes] = asyncio.Queue()
        self._tasks: list[asyncio.Task[None]] = []
        self._tools: StageTools | None = None
        self._is_gone = False

    @property
    def page(self) -> str:
        """Address of a page that shows the avatar; empty where there is none."""
        return self.stage.page

    async def prepare(self) -> StageTools:
        """Open the session; its tools."""
        await self.stage.start()
        if self._tools is None:
            self._tools = StageTools(self.stage, await self.stage.place.tools())
        return self._tools

    async def register(self, client_tools: ClientTools) -> tuple[str, ...]:
        """Let the agent's client tools move this avatar; returns their names."""
        return register_tools(client_tools, await self.prepare(), asyncio.get_running_loop())

    # ---- what the SDK calls

    async def start(self, input_callback: Callable[[bytes], Awaitable[None]]) -> None:
        """The conversation begins."""
        await self.prepare()
        self._tasks = [asyncio.ensure_future(self._speak()), asyncio.ensure_future(self._perform())]
        if self._device is not None:
            loop = asyncio.get_running_loop()

            async def hear(audio: bytes) -> None:
                await input_callback(audio)
                await self._listen(audio)

            def hear_in_thread(audio: bytes) -> None:
                asyncio.run_coroutine_threadsafe(hear(audio), loop)

            is_async = inspect.iscoroutinefunction(self._device.start)
            await _maybe(self._device.start(hear if is_async else hear_in_thread))

    async def stop(self) -> None:
        """The conversation is over."""
        if self._device is not None:
            await _maybe(self._device.stop())
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.stage.close()

    async def output(self, audio: bytes) -> None:
        """The agent speaks; returns at once.

        Raises:
            AudioError: half a sample: these bytes are no 16-bit PCM.
        """
        if len(audio) % 2:
            raise AudioError(
                f"{len(audio)} bytes are no 16-bit samples; set the agent's output format to pcm_{self._rate}"
            )
        self._bytes.put_nowait(audio)

    async def interrupt(self) -> None:
        """The user spoke: silence at once."""
        while not self._bytes.empty():
            self._bytes.get_nowait()
        if self._device is not None:
            await _maybe(self._device.interrupt())
            self._down.clear()
        if self._is_gone or not self.stage.is_busy:
            return
        try:
            await self.stage.interrupt()
        except EchoAvatarError:
            self._is_gone = True

    # ---- inside

    async def _speak(self) -> None:
        while True:
            try:
                async with asyncio.timeout(PAUSE_S):
                    audio = await self._bytes.get()
            except TimeoutError:
                if not self._is_gone:
                    await self._try(self.stage.end())
                audio = await self._bytes.get()
            pcm = np.frombuffer(audio, "<i2")
            if self._is_gone or not await self._try(self.stage.say(pcm, self._rate)):
                await self._play(pcm, self._rate)  # the voice goes on without a body

    async def _perform(self) -> None:
        try:
            async for event in self.stage:
                if self._on_event is not None:
                    self._on_event(event)
                if isinstance(event, Hop) and event.pcm:
                    await self._play(np.frombuffer(event.pcm, "<i2"), SAMPLE_RATE_HZ)
        except EchoAvatarError:
            self._is_gone = True

    async def _play(self, pcm: np.ndarray[Any, Any], rate: int) -> None:
        if self._device is None:
            return
        if rate == SAMPLE_RATE_HZ:
            pcm = self._down.resample_chunk(pcm)
        elif rate != DEVICE_RATE:
            pcm = soxr.resample(pcm, rate, DEVICE_RATE)
        await _maybe(self._device.output(pcm.astype("<i2").tobytes()))

    async def _listen(self, audio: bytes) -> None:
        if not self._is_gone:
            await self._try(self.stage.hear_user(np.frombuffer(audio, "<i2"), DEVICE_RATE))

    async def _try(self, work: Awaitable[object]) -> bool:
        try:
            await work
        except EchoAvatarError:
            self._is_gone = True
        return not self._is_gone


class AvatarAudioInterface(AudioInterface):  # type: ignore[misc]
    """For `Conversation`, whose callbacks come from threads: the same, on an event loop of its own."""

    def __init__(self, where: str | Path | Engine = "default", **options: Any) -> None:
        """As `AsyncAvatarAudioInterface`; `device` may be `DefaultAudioInterface()`."""
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="echoavatar audio", daemon=True)
        self._thread.start()
        self.avatar = self._run(self._make(where, options))

    @property
    def page(self) -> str:
        """Address of a page that shows the avatar, once it is prepared."""
        return self.avatar.page

    def prepare(self) -> StageTools:
        """Open the session; its tools."""
        return self._run(self.avatar.prepare())

    def register(self, client_tools: ClientTools) -> tuple[str, ...]:
        """Let the agent's client tools move this avatar; returns their names."""
        return self._run(self.avatar.register(client_tools))

    def start(self, input_callback: Callable[[bytes], None]) -> None:
        """The conversation begins."""

        async def hear(audio: bytes) -> None:
            await asyncio.to_thread(input_callback, audio)  # it writes to a socket

        self._run(self.avatar.start(hear))

    def stop(self) -> None:
        """The conversation is over."""
        self._run(self.avatar.stop())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def output(self, audio: bytes) -> None:
        """The agent speaks."""
        self._run(self.avatar.output(audio))

    def interrupt(self) -> None:
        """The user spoke."""
        self._run(self.avatar.interrupt())

    async def _make(self, where: str | Path | Engine, options: dict[str, Any]) -> AsyncAvatarAudioInterface:
        return AsyncAvatarAudioInterface(where, **options)

    def _run(self, work: Coroutine[Any, Any, _Result]) -> _Result:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()


def register_tools(
    client_tools: ClientTools, tools: StageTools, loop: asyncio.AbstractEventLoop
) -> tuple[str, ...]:
    """Register the avatar's tools; `loop` is the stage's, which need not be the one that `client_tools` runs."""

    def handler(name: str) -> Callable[[dict[str, Any]], Awaitable[str]]:
        async def handle(parameters: dict[str, Any]) -> str:
            arguments = {key: value for key, value in parameters.items() if key != "tool_call_id"}
            calling = asyncio.run_coroutine_threadsafe(tools.call(name, arguments), loop)
            return json.dumps(await asyncio.wrap_future(calling))

        return handle

    for name in tools.names:
        client_tools.register(name, handler(name), is_async=True)
    return tools.names


async def _maybe(result: object) -> None:
    if inspect.isawaitable(result):
        await result
