"""Images beside the voice's sound, through Pipecat's own output transport."""

import asyncio
import time

import numpy as np
import pytest

pytest.importorskip("pipecat", reason="pip install ./integrations/pipecat-echoavatar")
pytest.importorskip("pipecat_echoavatar", reason="pip install ./integrations/pipecat-echoavatar")

from pipecat.frames.frames import (
    EndFrame,
    InterruptionFrame,
    OutputAudioRawFrame,
    OutputImageRawFrame,
    TTSAudioRawFrame,
    TTSStartedFrame,
    TTSStoppedFrame,
)
from pipecat.pipeline.pipeline import Pipeline
from pipecat.pipeline.worker import PipelineWorker
from pipecat.transports.base_transport import TransportParams
from pipecat.workers.runner import WorkerRunner
from pipecat_echoavatar import EchoAvatarProcessor, NullTransport
from tests.server.video.flashes import PERIOD, Flasher, beeps, judge_mean, middles

from echoavatar.engine import Engine
from echoavatar.files.avatar.avatar_renderer import Shot

SIZE = (128, 128)
ENOUGH_HZ = 12  # pictures a second below which flashes are not judged


class Screen(NullTransport):
    """Notes when each block of sound began to play, and when each image was shown."""

    def __init__(self) -> None:
        super().__init__(
            TransportParams(
                audio_out_enabled=True,
                video_out_enabled=True,
                video_out_is_live=True,
                video_out_width=SIZE[0],
                video_out_height=SIZE[1],
                video_out_framerate=25,
            )
        )
        self.heard: list[tuple[float, float]] = []  # time, loudness of 10 ms
        self.seen: list[tuple[float, float]] = []  # time, brightness

    async def write_audio_frame(self, frame: OutputAudioRawFrame) -> bool:
        blocks = np.frombuffer(frame.audio, np.int16).astype(float).reshape(-1, frame.sample_rate // 100)
        now = time.monotonic()
        self.heard += [(now + k / 100 + 0.005, float(np.sqrt((b**2).mean()))) for k, b in enumerate(blocks)]
        return await super().write_audio_frame(frame)

    async def write_video_frame(self, frame: OutputImageRawFrame) -> bool:
        assert frame.size == SIZE
        self.seen.append((time.monotonic(), float(np.frombuffer(frame.image, np.uint8).mean())))
        return True


def test_images_are_in_step_with_the_voice_and_go_on_in_silence() -> None:
    screen = Screen()

    async def run() -> float:
        avatar = EchoAvatarProcessor(Engine(Flasher(), seats=1), video=Shot(SIZE))  # type: ignore[arg-type]
        worker = PipelineWorker(Pipeline([avatar, screen]), cancel_on_idle_timeout=False)

        async def act() -> float:
            async with asyncio.timeout(60):
                while len(screen.seen) < 5:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            said = (beeps(4) * 32_767).astype(np.int16).tobytes()
            await worker.queue_frame(TTSStartedFrame())
            for start in range(0, len(said), 9_600):
                part = said[start : start + 9_600]
                await worker.queue_frame(TTSAudioRawFrame(audio=part, sample_rate=24_000, num_channels=1))
            await worker.queue_frame(TTSStoppedFrame())
            await asyncio.sleep(5 * PERIOD / 24_000 + 1)
            await worker.queue_frame(InterruptionFrame())
            cut = time.monotonic()
            await asyncio.sleep(1)
            await worker.queue_frame(EndFrame())
            return cut

        runner = WorkerRunner()
        await runner.add_workers(worker)
        acting = asyncio.ensure_future(act())
        await asyncio.wait_for(runner.run(), 120)
        return await acting

    cut = asyncio.run(run())
    seen, heard = np.array(screen.seen), np.array(screen.heard)
    assert (seen[:, 0] > cut).sum() > 3, "the picture froze"
    light = (seen[:, 1] - seen[:, 1].min()) / np.ptp(seen[:, 1])
    flashes, sounds = middles(seen[:, 0], light), middles(heard[:, 0], np.clip(heard[:, 1] / 8_000, 0, 1))
    offsets = np.array([flash - sounds[np.abs(sounds - flash).argmin()] for flash in flashes])
    interval = float(np.median(np.diff(seen[:, 0])))
    if interval > 1 / ENOUGH_HZ:
        pytest.skip(f"{1 / interval:.0f} pictures a second are too few to time flashes (from {ENOUGH_HZ} on)")
    assert len(offsets) >= 2
    judge_mean(offsets, max(0.045, interval / 2))  # a block of sound is 40 ms
