"""The avatar in a pipeline: it takes the voice's sound and gives it back with motion in front of every hop.

    stt, user_aggregator, llm, tts, EchoAvatarProcessor(), transport.output(), assistant_aggregator

Motion goes to the client as RTVI server messages in the transport's own queue: an output transport delivers a queued
message when the sound in front of it is written, and drops both on an interruption. So the order motion, then sound, is
the synchronisation. Music must come from here (`play_music`): what a mixer adds behind the avatar, it does not hear.
"""

import contextlib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
from loguru import logger
from pipecat.adapters.llm.schemas.function_schema import FunctionSchema
from pipecat.frames.frames import (
    Frame,
    InputAudioRawFrame,
    InputTransportMessageFrame,
    InterruptionFrame,
    OutputTransportMessageFrame,
    OutputTransportMessageUrgentFrame,
    StartFrame,
    SystemFrame,
    TTSAudioRawFrame,
    TTSStoppedFrame,
)
from pipecat.processors.frame_processor import FrameDirection, FrameProcessor, FrameProcessorSetup
from pipecat.processors.frameworks.rtvi import RTVIClientMessageFrame

from echoavatar import EchoAvatarError, Engine
from echoavatar.integrations import Cut, Hop, Said, Stage, StageTools, find_place
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire import Ready

from .frames import AvatarMusicFrame, AvatarSpeechFrame, asks_for_avatar, rtvi
from .held import Held
from .tools import direct_functions, function_schemas
from .written import WrittenObserver


class EchoAvatarProcessor(FrameProcessor):
    """A body for the bot. Where the avatar fails, the voice goes on without it."""

    def __init__(
        self,
        where: str | Path | Engine = "default",
        *,
        token: str = "",
        seed: int = 0,
        page_port: int | None = None,
        listens: bool = True,
        **kwargs: Any,
    ) -> None:
        """`where`: a server's address (http://...), or a bundle's name or folder, or an engine, to run in this process.

        `page_port` serves the live page of an engine that runs here (0: any free port), `listens` lets the avatar hear
        the user and look at them; `token` is the server's.
        """
        super().__init__(**kwargs)
        self.stage = Stage(find_place(where, token=token, port=page_port), seed=seed)
        self._listens = listens
        self._held = Held()
        self._tools: StageTools | None = None
        self._performing: Any = None
        self._is_gone = False
        self._is_speaking = False
        self._register_event_handler("on_avatar_ready")

    def can_generate_metrics(self) -> bool:
        """Time to the first hop of an utterance."""
        return True

    # ---- for the bot's owner

    @property
    def page(self) -> str:
        """Address of a page that shows the avatar; empty where there is none."""
        return self.stage.page

    @property
    def tools(self) -> list[FunctionSchema]:
        """For `LLMContext(tools=ToolsSchema(standard_tools=avatar.tools))`: the registry's own schemas, with handlers.

        They name the gestures and tracks there are, so they exist once the avatar does: after `prepare`.
        """
        return function_schemas(self.tool_calls)

    @property
    def direct_functions(self) -> list[Callable[..., Awaitable[None]]]:
        """The same as direct functions, for a context's `tools=[...]`; their names are told in their docstrings."""
        return direct_functions(self.tool_calls)

    async def prepare(self) -> None:
        """Open the session before the pipeline does, to know its tools and its page.

        Raises:
            EchoAvatarError: there is no server, no bundle or no seat.
        """
        await self.stage.start()
        if self._tools is None:
            self._tools = StageTools(self.stage, await self.stage.place.tools())

    @property
    def tool_calls(self) -> StageTools:
        """Declarations, and `call(name, arguments)`, for a bot that does without a language model."""
        if self._tools is None:
            raise EchoAvatarError("the avatar's tools are not known yet; await avatar.prepare() first")
        return self._tools

    # ---- what Pipecat calls

    async def setup(self, setup: FrameProcessorSetup) -> None:
        """Open the session, and watch what the transport writes."""
        await super().setup(setup)
        setup.pipeline_worker.add_observer(WrittenObserver(self.stage))
        with contextlib.suppress(Exception):  # what it raises where RTVI is switched off
            setup.pipeline_worker.rtvi.add_event_handler("on_client_ready", self._greet)
        try:
            await self.prepare()
        except EchoAvatarError as error:
            self._is_gone = True
            await self.push_error(error_msg=f"no avatar, the voice goes on without: {error}", exception=error)

    async def cleanup(self) -> None:
        """End the session."""
        await super().cleanup()
        if self._performing is not None:
            await self.cancel_task(self._performing)
            self._performing = None
        await self.stage.close()

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Take in speech, let everything else pass behind the speech it came behind."""
        await super().process_frame(frame, direction)
        if isinstance(frame, StartFrame):
            await self.push_frame(frame, direction)
            if not self._is_gone:
                self._performing = self.create_task(self._perform(), "perform")
        elif self._is_gone or direction is FrameDirection.UPSTREAM:
            await self.push_frame(frame, direction)
        elif isinstance(frame, InterruptionFrame):
            await self.push_frame(frame, direction)
            await self._interrupt()
        elif isinstance(frame, SystemFrame):
            await self.push_frame(frame, direction)
            await self._notice(frame)
        elif isinstance(frame, TTSAudioRawFrame):
            await self._say(frame)
        else:
            await self._follow(frame)

    # ---- inside

    async def _say(self, frame: TTSAudioRawFrame) -> None:
        pcm = np.frombuffer(frame.audio, "<i2").reshape(-1, frame.num_channels)[:, 0]
        if not self._is_speaking:
            self._is_speaking = True
            await self.start_ttfb_metrics()
        self._held.hold(frame, len(pcm) * SAMPLE_RATE_HZ // frame.sample_rate)
        await self._safely(self.stage.say(pcm, frame.sample_rate))

    async def _follow(self, frame: Frame) -> None:
        if isinstance(frame, TTSStoppedFrame):
            self._is_speaking = False
            seg = await self._safely(self.stage.end())
            if seg:
                self._held.end(seg)
        if self._held.is_empty or self._is_gone:
            await self.push_frame(frame)
        else:
            self._held.hold(frame)

    async def _interrupt(self) -> None:
        """Nothing stale leaves from here on: hops that were not handed out are forgotten at once."""
        self._is_speaking = False
        kept = self._held.cut()
        if self.stage.is_busy:
            await self._safely(self.stage.interrupt())
        for frame in kept:
            await self.push_frame(frame)

    async def _notice(self, frame: SystemFrame) -> None:
        if isinstance(frame, InputAudioRawFrame) and self._listens:
            pcm = np.frombuffer(frame.audio, "<i2").reshape(-1, frame.num_channels)[:, 0]
            await self._safely(self.stage.hear_user(pcm, frame.sample_rate))
        elif isinstance(frame, RTVIClientMessageFrame):
            if frame.type == "echoavatar":
                await self._greet()
        elif isinstance(frame, InputTransportMessageFrame) and asks_for_avatar(frame.message):
            await self._greet()

    async def _greet(self, *_: object) -> None:
        """A client has come, or asks: it must be told of the rig."""
        if not self._is_gone:
            await self.push_frame(OutputTransportMessageUrgentFrame(message=rtvi(self.stage.ready)))

    async def _perform(self) -> None:
        """Hand out what the avatar does, when it is due."""
        try:
            async for event in self.stage:
                match event:
                    case Hop():
                        await self._show(event)
                    case Said():
                        for frame in self._held.over(event.seg):
                            await self.push_frame(frame)
                    case Cut():
                        await self.push_frame(OutputTransportMessageUrgentFrame(message=rtvi(event.flush)))
                    case Ready():
                        await self._call_event_handler("on_avatar_ready", event)
                        await self.push_frame(OutputTransportMessageUrgentFrame(message=rtvi(event)))
                    case _:
                        await self.push_frame(OutputTransportMessageFrame(message=rtvi(event)))
        except EchoAvatarError as error:
            await self._give_up(error)

    async def _show(self, hop: Hop) -> None:
        kind = OutputTransportMessageUrgentFrame if hop.is_again else OutputTransportMessageFrame
        await self.push_frame(kind(message=rtvi(hop.motion)))
        if hop.pcm:
            if hop.seg:
                await self.stop_ttfb_metrics()
            sound = AvatarSpeechFrame if hop.seg else AvatarMusicFrame
            await self.push_frame(sound(audio=hop.pcm, sample_rate=SAMPLE_RATE_HZ, num_channels=1))
        if hop.seg and not hop.is_again:
            for frame in self._held.left(hop.motion.frames * SAMPLES_PER_FRAME):
                await self.push_frame(frame)

    async def _safely(self, work: Awaitable[Any]) -> Any:
        try:
            return await work
        except EchoAvatarError as error:
            await self._give_up(error)

    async def _give_up(self, error: EchoAvatarError) -> None:
        """The voice goes on: what waited for motion goes without."""
        if self._is_gone:
            return
        self._is_gone = True
        logger.error(f"{self}: {error}; the voice goes on without an avatar")
        for frame in self._held.give_up():
            await self.push_frame(frame)
        await self.push_error(error_msg=str(error), exception=error)
