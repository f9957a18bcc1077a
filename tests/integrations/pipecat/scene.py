"""A pipeline with a minimal avatar, and a transport that records what it wrote and when."""

import asyncio
import json
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence

import numpy as np
from loguru import logger
from pipecat.frames.frames import (
    EndFrame,
    Frame,
    OutputAudioRawFrame,
    OutputTransportMessageFrame,
    OutputTransportMessageUrgentFrame,
    TTSAudioRawFrame,
    TTSStartedFrame,
    TTSStoppedFrame,
)
from pipecat.pipeline.pipeline import Pipeline
from pipecat.pipeline.worker import PipelineParams, PipelineWorker
from pipecat.processors.frame_processor import FrameProcessor
from pipecat.services.settings import TTSSettings
from pipecat.services.tts_service import TTSService
from pipecat.workers.runner import WorkerRunner
from pipecat_echoavatar import EchoAvatarProcessor, NullTransport
from tests.agents.integrations.fakes import engine
from tests.agents.integrations.fakes import tone as samples

logger.remove()  # it would log thousands of lines per test


def tone(seconds: float, rate: int = 24_000, level: float = 8_000) -> bytes:
    return samples(seconds, rate, level).tobytes()


class RecordingTransport(NullTransport):
    """Records everything that reached the user, in order: sound and the avatar's messages."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[tuple[float, str, dict | bytes]] = []  # type: ignore[type-arg]

    async def write_audio_frame(self, frame: OutputAudioRawFrame) -> bool:
        if type(frame) is not OutputAudioRawFrame:  # silence that the base class appends
            self.seen.append((time.monotonic(), type(frame).__name__, frame.audio))
        return await super().write_audio_frame(frame)

    async def send_message(self, frame: OutputTransportMessageFrame | OutputTransportMessageUrgentFrame) -> None:
        if frame.message.get("type") != "server-message":
            return  # Pipecat's own
        data = frame.message["data"]
        assert frame.message["label"] == "rtvi-ai"
        assert data["type"] == "echoavatar"
        json.dumps(frame.message)  # as real transports do
        self.seen.append((time.monotonic(), data["message"]["type"], data["message"]))

    @property
    def sound(self) -> np.ndarray:
        blocks = [np.frombuffer(what, "<i2") for _, _, what in self.seen if isinstance(what, bytes)]
        return np.concatenate([np.zeros(0, np.int16), *blocks])

    def messages(self, kind: str) -> list[dict]:  # type: ignore[type-arg]
        return [what for _, name, what in self.seen if name == kind and isinstance(what, dict)]


class Scene:
    """What a test's script works with."""

    def __init__(self, avatar: EchoAvatarProcessor, transport: RecordingTransport, worker: PipelineWorker) -> None:
        self.avatar, self.transport, self._worker = avatar, transport, worker

    async def push(self, *frames: Frame) -> None:
        for frame in frames:
            await self._worker.queue_frame(frame)

    async def speak(self, seconds: float, *, blocks: int = 10, stop: bool = True) -> None:
        """Push speech as a voice service does: all at once, in blocks."""
        pcm = tone(seconds)
        size = len(pcm) // blocks // 2 * 2
        await self.push(TTSStartedFrame())
        for start in range(0, len(pcm), size):
            await self.push(TTSAudioRawFrame(audio=pcm[start : start + size], sample_rate=24_000, num_channels=1))
        if stop:
            await self.push(TTSStoppedFrame())

    async def until(self, what: Callable[[], bool], seconds: float = 10.0) -> None:
        end = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < end, "it never happened"
            await asyncio.sleep(0.01)


class Voice(TTSService):
    """Says each word of a text in half a second, three times as fast, and tells when it is said."""

    def __init__(self) -> None:
        settings = TTSSettings(model=None, voice=None, language=None)
        super().__init__(settings=settings, push_start_frame=True, push_stop_frames=True, push_text_frames=False)

    async def run_tts(self, text: str, context_id: str) -> AsyncGenerator[Frame | None, None]:
        words = [(word, 0.5 * k) for k, word in enumerate(text.split())]
        await self.add_word_timestamps(words[:1], context_id)  # before its sound
        for k in range(len(words)):
            yield TTSAudioRawFrame(audio=tone(0.5), sample_rate=24_000, num_channels=1, context_id=context_id)
            await self.add_word_timestamps(words[k + 1 : k + 2], context_id)
            await asyncio.sleep(0.15)


def play(
    script: Callable[[Scene], Awaitable[None]], where: object = None, *, before: Sequence[FrameProcessor] = ()
) -> RecordingTransport:
    """Run a script in a pipeline, then end the pipeline; `before` comes in front of the avatar."""

    async def run() -> RecordingTransport:
        avatar = EchoAvatarProcessor(where or engine())  # type: ignore[arg-type]
        transport = RecordingTransport()
        pipeline = Pipeline([*before, avatar, transport])
        worker = PipelineWorker(pipeline, params=PipelineParams(), cancel_on_idle_timeout=False)
        begun = asyncio.Event()

        @worker.event_handler("on_pipeline_started")
        async def _begun(worker: object, frame: object) -> None:
            begun.set()

        async def act() -> None:
            await asyncio.wait_for(begun.wait(), 120)
            scene = Scene(avatar, transport, worker)
            try:
                await script(scene)
            finally:
                await worker.queue_frame(EndFrame())

        runner = WorkerRunner()
        await runner.add_workers(worker)
        acting = asyncio.ensure_future(act())
        await asyncio.wait_for(runner.run(), 150)
        await acting
        return transport

    return asyncio.run(run())
