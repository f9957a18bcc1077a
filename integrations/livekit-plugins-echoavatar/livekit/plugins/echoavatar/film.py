"""The avatar as a video and an audio track, through LiveKit's own runner.

The runner publishes both tracks and keeps them together. What is said and what is interrupted stays with the performer:
it reports exactly what was heard, and music is heard too. To the performer this is what plays the sound.
"""

import asyncio
import time
from collections.abc import AsyncIterator

import numpy as np
from jaxtyping import UInt8
from livekit import rtc
from livekit.agents.voice.avatar import AudioReceiver, AudioSegmentEnd, AvatarOptions, AvatarRunner, VideoGenerator

from echoavatar.agents.integrations import AvatarBridge, AvatarChunk
from echoavatar.files.avatar.avatar_renderer import Shot
from echoavatar.server.video import LiveStream, VideoSource
from echoavatar.server.video.live_stream import EDGE, PICTURE_RATE_HZ
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.messages import Flush

Item = rtc.VideoFrame | rtc.AudioFrame
MOST_LATE_S = 0.1  # what the runner's queue holds; sound that is later would stay behind its pictures for good
MOST_DRAWN = 4  # pictures that wait for it


class _NoSpeech(AudioReceiver):
    """The runner's receiver: speech reaches the avatar through the performer."""

    def notify_playback_finished(self, playback_position: float, interrupted: bool) -> None:
        """The performer reports."""

    def notify_playback_started(self) -> None:
        """The performer reports."""

    async def __aiter__(self) -> AsyncIterator[rtc.AudioFrame | AudioSegmentEnd]:
        """Nothing comes."""
        await asyncio.Event().wait()
        yield AudioSegmentEnd()


class Film(VideoGenerator):
    """Pictures and sound of one avatar: LiveKit's generator, and the performer's source."""

    def __init__(self, bridge: AvatarBridge, shot: Shot, character: str = "") -> None:
        """Raises EchoAvatarError if there is no such character or background; the bridge has started."""
        self.shot = shot
        self._pictured = VideoSource(bridge.ready.rig, shot, character=character)
        self._stream = LiveStream(
            self._pictured, lambda: bridge.playback.position(time.monotonic()), late_s=MOST_LATE_S
        )
        self.speaker: rtc.AudioSource | None = None  # through which the runner plays the sound
        self._drawn = asyncio.Queue[tuple[float, UInt8[np.ndarray, "h w c"]]](MOST_DRAWN)  # time due, pixels
        self._audible = 0  # clock at the end of the newest chunk that has sound

    # ---- for the performer

    def take(self, chunk: AvatarChunk) -> None:
        """Take motion and its sound; a chunk without sound is silent."""
        for message in chunk.messages():
            self._pictured.take(message)
        if chunk.pcm:
            self._audible = chunk.at + len(chunk.pcm) // 2

    def flush(self, flush: Flush) -> None:
        """Forget what was taken back."""
        self._pictured.take(flush)
        self._audible = min(self._audible, flush.at)

    @property
    def queued_duration(self) -> float:
        """Seconds of sound that wait to be played."""
        return max(0, self._audible - self._stream.place) / SAMPLE_RATE_HZ

    async def capture_frame(self, frame: rtc.AudioFrame) -> None:
        """The sound came with its motion already (`take`)."""

    def clear_queue(self) -> None:
        """Fall silent at once; the motion stays until the session says where it was cut."""
        self._audible = place = self._stream.place
        self._pictured.mute(place)

    # ---- for the runner

    async def push_audio(self, frame: rtc.AudioFrame | AudioSegmentEnd) -> None:
        """Not called: the runner's receiver brings nothing."""

    def clear_buffer(self) -> None:
        """Not called: the performer hears of interruptions."""

    def __aiter__(self) -> AsyncIterator[Item]:
        return self._items()

    async def _items(self) -> AsyncIterator[Item]:
        """Sound and pictures as they are due; the one does not wait for the other."""
        drawing = asyncio.ensure_future(self._draw())
        makers = {
            self._sound: asyncio.ensure_future(self._sound()),
            self._picture: asyncio.ensure_future(self._picture()),
        }
        try:
            while True:
                await asyncio.wait([*makers.values(), drawing], return_when=asyncio.FIRST_COMPLETED)
                if drawing.done():  # only by an error
                    drawing.result()
                for make, task in list(makers.items()):
                    if task.done():
                        makers[make] = asyncio.ensure_future(make())
                        yield task.result()
        finally:
            tasks = [*makers.values(), drawing]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self._stream.close()

    async def _sound(self) -> Item:
        samples = (await self._stream.sound()).samples[EDGE:-EDGE]
        return rtc.AudioFrame(samples.tobytes(), SAMPLE_RATE_HZ, 1, len(samples))

    async def _draw(self) -> None:
        """Draw without end; sound waits in the runner's queue, longer after a hiccup, and so does its picture."""
        while True:
            pixels = (await self._stream.picture()).pixels
            late_s = self.speaker.queued_duration if self.speaker is not None else 0.0
            await self._drawn.put((time.monotonic() + late_s, pixels))

    async def _picture(self) -> Item:
        due, pixels = await self._drawn.get()
        await asyncio.sleep(max(0.0, due - time.monotonic()))
        high, wide, _ = pixels.shape
        return rtc.VideoFrame(wide, high, rtc.VideoBufferType.RGB24, np.ascontiguousarray(pixels).tobytes())


def runner(room: rtc.Room, film: Film) -> AvatarRunner:
    """LiveKit's runner for a film; start it once the room is connected."""
    wide, high = film.shot.size
    options = AvatarOptions(
        video_width=wide,
        video_height=high,
        video_fps=PICTURE_RATE_HZ,
        audio_sample_rate=SAMPLE_RATE_HZ,
        audio_channels=1,
    )
    made = AvatarRunner(room, audio_recv=_NoSpeech(), video_gen=film, options=options)
    film.speaker = getattr(made, "_audio_source", None)  # the runner has no public name for it
    return made
