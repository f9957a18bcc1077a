"""The avatar in a pipeline: it takes the voice's sound and returns it with motion in front of every chunk.

    stt, user_aggregator, llm, tts, EchoAvatarProcessor(), transport.output(), assistant_aggregator

Motion goes to the client as RTVI server messages in the transport's own queue. An output transport delivers a queued
message once the sound in front of it is written, and drops both on an interruption, so the queue's order keeps motion
and sound in sync. Play music through the avatar (`play_music`): it cannot hear what a mixer adds after it.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from loguru import logger
from pipecat.adapters.llm.schemas.function_schema import FunctionSchema
from pipecat.frames.frames import (
    Frame,
    InputAudioRawFrame,
    InputTransportMessageFrame,
    InterruptionFrame,
    OutputAudioRawFrame,
    OutputImageRawFrame,
    OutputTransportMessageFrame,
    OutputTransportMessageUrgentFrame,
    StartFrame,
    SystemFrame,
    TTSAudioRawFrame,
    TTSStoppedFrame,
    TTSTextFrame,
)
from pipecat.processors.frame_processor import FrameDirection, FrameProcessor, FrameProcessorSetup
from pipecat.processors.frameworks.rtvi import RTVIClientMessageFrame

from echoavatar import EchoAvatarError, Engine
from echoavatar.agents.integrations import AvatarBridge, AvatarChunk, AvatarTools, Flushed, UtteranceDone, find_backend
from echoavatar.files.avatar.avatar_renderer import Shot
from echoavatar.server.video import LiveStream, VideoSource
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.messages import BodyOptions, Ready

from .frames import AvatarMusicFrame, AvatarSpeechFrame, asks_for_avatar, rtvi
from .pending_frames import PendingFrames
from .playback_observer import PlaybackObserver
from .tools import direct_functions, function_schemas

CLOSE_S = 0.04  # pictures follow the sound that the transport wrote as closely as its blocks tell


class EchoAvatarProcessor(FrameProcessor):
    """Gives the bot a body. If the avatar fails, the voice goes on without it."""

    def __init__(
        self,
        where: str | Path | Engine = "default",
        *,
        token: str = "",
        seed: int = 0,
        body: BodyOptions | None = None,
        page_port: int | None = None,
        listens: bool = True,
        video: Shot | None = None,
        character: str = "",
        **kwargs: Any,
    ) -> None:
        """`where`: a server's address (http://...), or a bundle's name or folder, or an engine, which then runs here.

        `page_port` serves the live page of an engine that runs here (0: any free port). With `listens` the avatar hears
        the user and looks at them. `token` is the server's. `body`, such as `BodyOptions(leash_m=0.5)`, keeps the
        avatar near its place. With `video`, such as `Shot((512, 512))`, the avatar is drawn here and pushed as images
        beside its sound; `character` says who.
        """
        super().__init__(**kwargs)
        self.bridge = AvatarBridge(find_backend(where, token=token, port=page_port), seed=seed, body=body)
        self._listens = listens
        self._pending = PendingFrames()
        self._tools: AvatarTools | None = None
        self._performing: Any = None
        self._filming: Any = None
        self._shot, self._character = video, character
        self._pictured: VideoSource | None = None
        self._has_failed = False
        self._has_told = False  # of sound that is none of speech
        self._is_speaking = False
        self._context: tuple[str | None] | None = None  # of the voice, whose words are timed
        self._begun_ns = self._word_ns = 0  # pts of its utterance's first sample, and of the newest word
        self._register_event_handler("on_avatar_ready")

    def can_generate_metrics(self) -> bool:
        """Whether metrics are available: the time to the first chunk of an utterance."""
        return True

    # ---- for the bot

    @property
    def page(self) -> str:
        """Address of a page that shows the avatar; empty if there is none."""
        return self.bridge.page

    @property
    def tools(self) -> list[FunctionSchema]:
        """For `LLMContext(tools=ToolsSchema(standard_tools=avatar.tools))`: the avatar's schemas with handlers.

        They list the avatar's gestures and tracks, so they are known after `prepare`.
        """
        return function_schemas(self.tool_calls)

    @property
    def direct_functions(self) -> list[Callable[..., Awaitable[None]]]:
        """The same tools as direct functions, for a context's `tools=[...]`; docstrings list the possible values."""
        return direct_functions(self.tool_calls)

    async def prepare(self) -> None:
        """Open the session before the pipeline does, so that its tools and its page are known.

        Raises:
            EchoAvatarError: there is no server, no bundle or no free seat.
        """
        await self.bridge.start()
        if self._tools is None:
            self._tools = AvatarTools(self.bridge, await self.bridge.backend.tools())

    @property
    def tool_calls(self) -> AvatarTools:
        """Declarations and `call(name, arguments)`, for a bot without a language model."""
        if self._tools is None:
            raise EchoAvatarError("the avatar's tools are not known yet; await avatar.prepare() first")
        return self._tools

    # ---- called by Pipecat

    async def setup(self, setup: FrameProcessorSetup) -> None:
        """Open the session and observe what the transport writes."""
        await super().setup(setup)
        setup.pipeline_worker.add_observer(PlaybackObserver(self.bridge))
        with contextlib.suppress(Exception):  # raised if RTVI is switched off
            setup.pipeline_worker.rtvi.add_event_handler("on_client_ready", self._greet)
        try:
            await self.prepare()
        except EchoAvatarError as error:
            self._has_failed = True
            await self.push_error(error_msg=f"no avatar, the voice goes on without: {error}", exception=error)

    async def cleanup(self) -> None:
        """End the session."""
        await super().cleanup()
        if self._performing is not None:
            await self.cancel_task(self._performing)
            self._performing = None
        if self._filming is not None:
            await self.cancel_task(self._filming)
            self._filming = None
        await self.bridge.close()

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Take speech in; keep every other frame behind the speech it came behind."""
        await super().process_frame(frame, direction)
        if isinstance(frame, StartFrame):
            await self.push_frame(frame, direction)
            if not self._has_failed:
                self._performing = self.create_task(self._perform(), "perform")
            if not self._has_failed and self._shot is not None:
                self._pictured = await asyncio.to_thread(self._make_pictured, self._shot)
                self._filming = self.create_task(self._film(self._pictured), "film")
        elif self._has_failed or direction is FrameDirection.UPSTREAM:
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
            if isinstance(frame, TTSTextFrame) and frame.pts:
                await self._tell(frame, frame.pts)
            await self._follow(frame)

    # ---- internals

    async def _say(self, frame: TTSAudioRawFrame) -> None:
        if not self._is_speaking:
            self._is_speaking = True
            await self.start_ttfb_metrics()
        self._begin(frame.context_id)
        self._pending.add(frame, frame.num_frames * SAMPLE_RATE_HZ // frame.sample_rate)
        await self._attempt(self.bridge.say(frame.audio, frame.sample_rate, frame.num_channels))

    async def _tell(self, frame: TTSTextFrame, pts: int) -> None:
        """Tell a word; it comes before its sound."""
        self._begin(frame.context_id)
        self._word_ns = pts
        text = frame.text if frame.includes_inter_frame_spaces else f"{frame.text} "
        await self._attempt(self.bridge.words([(text, (pts - self._begun_ns) / 1e9)]))

    def _begin(self, context: str | None) -> None:
        """Pipecat counts the words of a context from its first sound on, or from the newest word if that is later."""
        if self._context != (context,):
            self._context = (context,)
            begun = max(self.get_clock().get_time(), self._word_ns)
            self._begun_ns = begun - round(self.bridge.said_s * 1e9)

    async def _follow(self, frame: Frame) -> None:
        if isinstance(frame, OutputAudioRawFrame) and not self._has_told:
            self._has_told = True
            logger.warning(
                f"{self}: the avatar does not move to a {type(frame).__name__}; push TTSAudioRawFrame for speech"
            )
        if isinstance(frame, TTSStoppedFrame):
            self._is_speaking, self._context = False, None
            seg = await self._attempt(self.bridge.end())
            if seg:
                self._pending.mark_end(seg)
        if self._pending.is_empty or self._has_failed:
            await self.push_frame(frame)
        else:
            self._pending.add(frame)

    async def _interrupt(self) -> None:
        """Interrupt the avatar; from here on no stale chunk is released."""
        self._is_speaking, self._context, self._word_ns = False, None, 0
        kept = self._pending.interrupt()
        if self.bridge.is_busy:
            await self._attempt(self.bridge.interrupt())
        for frame in kept:
            await self.push_frame(frame)

    async def _notice(self, frame: SystemFrame) -> None:
        if isinstance(frame, InputAudioRawFrame) and self._listens:
            await self._attempt(self.bridge.hear_user(frame.audio, frame.sample_rate, frame.num_channels))
        elif isinstance(frame, RTVIClientMessageFrame):
            if frame.type == "echoavatar":
                await self._greet()
        elif isinstance(frame, InputTransportMessageFrame) and asks_for_avatar(frame.message):
            await self._greet()

    async def _greet(self, *_: object) -> None:
        """Describe the rig to a client that has connected, or that asks."""
        if not self._has_failed:
            await self.push_frame(OutputTransportMessageUrgentFrame(message=rtvi(self.bridge.ready)))

    async def _perform(self) -> None:
        """Push what the avatar does, when it is due."""
        try:
            async for event in self.bridge:
                match event:
                    case AvatarChunk():
                        await self._show(event)
                    case UtteranceDone():
                        for frame in self._pending.finish(event.seg):
                            await self.push_frame(frame)
                    case Flushed():
                        if self._pictured is not None:
                            self._pictured.take(event.flush)
                        await self.push_frame(OutputTransportMessageUrgentFrame(message=rtvi(event.flush)))
                    case Ready():
                        await self._call_event_handler("on_avatar_ready", event)
                        await self.push_frame(OutputTransportMessageUrgentFrame(message=rtvi(event)))
                    case _:
                        await self.push_frame(OutputTransportMessageFrame(message=rtvi(event)))
        except EchoAvatarError as error:
            await self._give_up(error)

    def _make_pictured(self, shot: Shot) -> VideoSource:
        ready = self.bridge.ready
        return VideoSource(ready.rig, shot, character=self._character)

    async def _film(self, pictured: VideoSource) -> None:
        """Push pictures of what is heard; the transport shows each at once."""
        stream = LiveStream(pictured, lambda: self.bridge.playback.position(time.monotonic()), far_s=CLOSE_S)
        try:
            while not self._has_failed:
                pixels = (await stream.picture()).pixels
                size = (pixels.shape[1], pixels.shape[0])
                await self.push_frame(OutputImageRawFrame(image=pixels.tobytes(), size=size, format="RGB"))
        finally:
            await stream.close()

    async def _show(self, chunk: AvatarChunk) -> None:
        if self._pictured is not None:
            for message in chunk.messages():
                self._pictured.take(message)
        kind = OutputTransportMessageUrgentFrame if chunk.is_revision else OutputTransportMessageFrame
        await self.push_frame(kind(message=rtvi(chunk.motion)))
        if chunk.pcm:
            if chunk.seg:
                await self.stop_ttfb_metrics()
            sound = AvatarSpeechFrame if chunk.seg else AvatarMusicFrame
            await self.push_frame(sound(audio=chunk.pcm, sample_rate=SAMPLE_RATE_HZ, num_channels=1))
        if chunk.seg and not chunk.is_revision:
            for frame in self._pending.release(chunk.motion.frames * SAMPLES_PER_FRAME):
                await self.push_frame(frame)

    async def _attempt(self, work: Awaitable[Any]) -> Any:
        try:
            return await work
        except EchoAvatarError as error:
            await self._give_up(error)

    async def _give_up(self, error: EchoAvatarError) -> None:
        """Continue without the avatar: push what waited for motion as it came."""
        if self._has_failed:
            return
        self._has_failed = True
        logger.error(f"{self}: {error}; the voice goes on without an avatar")
        for frame in self._pending.drain():
            await self.push_frame(frame)
        await self.push_error(error_msg=str(error), exception=error)
