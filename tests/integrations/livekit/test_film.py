"""Video and sound as LiveKit's runner publishes them, read back from the tracks."""

import asyncio
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("livekit.agents", reason="pip install ./integrations/livekit-plugins-echoavatar")
pytest.importorskip("livekit.plugins.echoavatar", reason="pip install ./integrations/livekit-plugins-echoavatar")

from livekit import rtc
from livekit.agents import AgentSession
from livekit.plugins.echoavatar import AvatarSession
from tests.integrations.livekit.rooms import Room
from tests.server.video.flashes import PERIOD, Flasher, beeps, judge_mean, middles

from echoavatar.engine import Engine
from echoavatar.files.avatar.avatar_renderer import Shot

ENOUGH_HZ = 12  # pictures a second below which nothing is judged


class Participants:
    """What a subscriber sees and hears of the tracks of a room, and when."""

    def __init__(self, room: Room) -> None:
        self.room = room
        self.pictures: list[tuple[float, float]] = []  # time, brightness
        self.sounds: list[tuple[float, float]] = []  # time, loudness of 10 ms
        self.size = (0, 0)
        self._tasks: list[asyncio.Task[None]] = []

    async def join(self) -> None:
        async with asyncio.timeout(60):
            while len(self.room.local_participant.tracks) < 2:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        sound, picture = self.room.local_participant.tracks
        self._tasks = [asyncio.ensure_future(self._hear(sound)), asyncio.ensure_future(self._see(picture))]

    async def leave(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _hear(self, track: Any) -> None:
        async for event in rtc.AudioStream(track, sample_rate=24_000, num_channels=1, frame_size_ms=10):
            samples = np.frombuffer(event.frame.data, np.int16).astype(float)
            self.sounds.append((time.monotonic() - len(samples) / 48_000, float(np.sqrt((samples**2).mean()))))

    async def _see(self, track: Any) -> None:
        async for event in rtc.VideoStream(track, format=rtc.VideoBufferType.RGB24):
            self.size = event.frame.width, event.frame.height
            self.pictures.append((time.monotonic(), float(np.frombuffer(event.frame.data, np.uint8).mean())))

    def rate(self, newest: int = 0) -> float:
        """Pictures a second, of all or of the newest so many."""
        return 1 / float(np.median(np.diff([moment for moment, _ in self.pictures[-newest:]])))

    def judge(self, rate: float) -> None:
        """Flashes come with their beeps, where pictures are frequent enough to tell."""
        if rate < ENOUGH_HZ:
            pytest.skip(f"{rate:.0f} pictures a second are too few to time flashes (from {ENOUGH_HZ} on)")
        offsets = self.offsets()
        assert len(offsets) >= 2
        judge_mean(offsets, 0.040)

    def offsets(self) -> np.ndarray:
        """Seconds that each flash comes after its beep."""
        seen, heard = np.array(self.pictures), np.array(self.sounds)
        seen = seen[seen[:, 1] > 50]  # a new track begins with black
        light = (seen[:, 1] - seen[:, 1].min()) / np.ptp(seen[:, 1])
        flashes, sounds = middles(seen[:, 0], light), middles(heard[:, 0], np.clip(heard[:, 1] / 8_000, 0, 1))
        nearest = [flash - sounds[np.abs(sounds - flash).argmin()] for flash in flashes]
        return np.array([offset for offset in nearest if abs(offset) < 0.3])


async def speak(sink: Any, samples: np.ndarray) -> None:
    pcm = (samples * 32_767).astype(np.int16)
    for start in range(0, len(pcm), 2_400):
        part = pcm[start : start + 2_400]
        await sink.capture_frame(rtc.AudioFrame(part.tobytes(), 24_000, 1, len(part)))
    sink.flush()


async def test_an_avatar_session_publishes_video_and_sound_in_step() -> None:
    room, session = Room("agent"), AgentSession()
    avatar = AvatarSession(Engine(Flasher(), seats=1), video=Shot((128, 128)))  # type: ignore[arg-type]
    watching = Participants(room)
    await avatar.start(session, room)  # type: ignore[arg-type]
    try:
        await watching.join()
        sink = session.output.audio
        await speak(sink, beeps(6))
        event = await asyncio.wait_for(sink.wait_for_playout(), 30)
        assert not event.interrupted
        assert event.playback_position == pytest.approx(7 * PERIOD / 24_000, abs=0.02)
        await speak(sink, beeps(8))
        await asyncio.sleep(1.5)
        sink.clear_buffer()
        event = await asyncio.wait_for(sink.wait_for_playout(), 10)
        assert event.interrupted
        assert 0.5 < event.playback_position < 2.5
        await asyncio.sleep(0.4)
        began = time.monotonic()
        await asyncio.sleep(1.5)
        late = [loudness for moment, loudness in watching.sounds if moment > began]
        assert late, "the track went silent for good"
        assert max(late) < 10, "stale sound was heard"
    finally:
        await avatar.aclose()
        await watching.leave()
    assert watching.size == (128, 128)
    watching.judge(watching.rate())


async def test_sound_does_not_stay_behind_after_a_hiccup() -> None:
    """Sound that comes late in one go would wait in the runner's queue, and all that follows behind it."""
    room, session = Room("agent"), AgentSession()
    avatar = AvatarSession(Engine(Flasher(), seats=1), video=Shot((128, 128)))  # type: ignore[arg-type]
    watching = Participants(room)
    await avatar.start(session, room)  # type: ignore[arg-type]
    try:
        await watching.join()
        await speak(session.output.audio, beeps(6))
        await asyncio.sleep(1.5)
        time.sleep(0.35)  # noqa: ASYNC251
        await asyncio.sleep(0.6)
        rate = watching.rate()
        watching.pictures.clear()
        watching.sounds.clear()
        await asyncio.sleep(3.5)
        if rate > 20:
            async with asyncio.timeout(20):  # as frequent again, at the latest when other load is over
                while watching.rate(25) < 0.6 * rate:  # noqa: ASYNC110
                    await asyncio.sleep(0.2)
    finally:
        await avatar.aclose()
        await watching.leave()
    watching.judge(min(rate, watching.rate()))
