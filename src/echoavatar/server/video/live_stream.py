"""A session in wall time: pictures and blocks of sound, each just before it is due.

Time of the stream runs from its first call and never stops; a moment of it shows one place of the session's clock.
That place follows the playhead of the session: it runs with the wall clock, waits where nothing has arrived, and jumps
if it is far off. Pictures are drawn ahead, one at a time, on a thread of their own. A slow machine leaves
pictures out: of those that could still be ready in time the first is drawn, none is queued.
"""

import asyncio
import math
import os
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from jaxtyping import Int16, UInt8

from echoavatar.timing import SAMPLE_RATE_HZ, exact_div

from .video_source import VideoSource

BLOCK_SAMPLES = exact_div(SAMPLE_RATE_HZ, 50)  # 20 ms
BLOCK_S = BLOCK_SAMPLES / SAMPLE_RATE_HZ
PICTURE_RATE_HZ = 25
EDGE = 16  # samples before and after a block, for a filter that resamples it
FAR_S = 0.25  # a stream with sound that is further off the playhead jumps to it
SLACK_S = 0.005  # allowance for the event loop
MOST_AHEAD_S = 0.15  # motion that is sure to be there (`engine.pacing.MARGIN_S`)
MOST_BEHIND_S = 0.5  # blocks of sound that are later are skipped, unless told otherwise
CALM = 0.1  # weight of the newest measurement in a mean
_SINC = np.sinc(np.arange(0.5 - EDGE, EDGE)) * np.hanning(2 * EDGE + 2)[1:-1]  # interpolates halfway between samples
_NICENESS = 5  # motion comes first


class Block(NamedTuple):
    """20 ms of sound."""

    seconds: float  # time of the stream
    samples: Int16[np.ndarray, " s"]  # mono, 24 kHz, with EDGE samples before and after


class Picture(NamedTuple):
    """One picture."""

    seconds: float  # time of the stream
    pixels: UInt8[np.ndarray, "h w c"]  # RGB


class LiveStream:
    """One viewer's stream of a session. Sound and pictures may each be awaited by one task."""

    def __init__(
        self,
        source: VideoSource,
        playhead: Callable[[], int],
        *,
        rate: int = PICTURE_RATE_HZ,
        far_s: float = FAR_S,
        late_s: float = MOST_BEHIND_S,
    ) -> None:
        """`playhead` gives the sample of the session's clock that is heard now.

        The stream jumps to it where it is off by more than `far_s`; a jump is heard, so be patient where sound is
        taken from the stream, and not where only pictures are. Blocks of sound that are later than `late_s` are
        skipped: allow little where a queue plays them without regard to when they were due, for there they stay late.
        """
        self.shown, self.skipped = 0, 0  # pictures
        self._source, self._playhead, self._rate = source, playhead, rate
        self._far, self._late = far_s * SAMPLE_RATE_HZ, late_s
        self._began: float | None = None
        self._began_wall: float | None = None
        self._anchor: tuple[int, int] | None = None  # a block, and the sample of the session that it begins with
        self._block = self._picture = -1  # numbers of the newest that were handed out
        self._drawing: asyncio.Task[Picture] | None = None
        self._draw_s, self._send_s = 0.04, 0.0  # how long a picture takes to draw; to be encoded by the receiver
        self._returned: float | None = None
        self._thread = ThreadPoolExecutor(1, "video", initializer=_give_way)

    def wall(self, seconds: float) -> float:
        """The time, in seconds since 1970, at which a moment of the stream is shown and heard.

        The wall clock is read once, so picture and sound stay together when that clock is set.
        """
        if self._began_wall is None:
            self._began_wall = time.time() - self._now()
        return self._began_wall + seconds

    @property
    def place(self) -> int:
        """The sample of the session's clock that is handed out now."""
        first, start = self._follow()
        return start + max(0, round((self._now() - first * BLOCK_S) * SAMPLE_RATE_HZ))

    async def sound(self) -> Block:
        """The next block of sound, when it is due. Blocks follow each other without a gap."""
        newest = math.floor(self._now() / BLOCK_S)
        if self._block < 0 or newest - self._block > self._late / BLOCK_S:
            self._block = newest
        self._block += 1
        await self._until(self._block * BLOCK_S)
        first, start = self._follow()
        if self._block < first:
            samples = np.zeros(BLOCK_SAMPLES + 2 * EDGE, np.int16)
        else:
            at = start + (self._block - first) * BLOCK_SAMPLES
            samples = self._source.sound(at - EDGE, BLOCK_SAMPLES + 2 * EDGE)
        return Block(self._block * BLOCK_S, samples)

    async def picture(self) -> Picture:
        """The next picture, when it is due; the one after it is drawn meanwhile."""
        if self._returned is not None:
            self._send_s += CALM * (min(time.monotonic() - self._returned, 1 / self._rate) - self._send_s)
        drawn = await (self._drawing or asyncio.ensure_future(self._draw()))
        self._drawing = asyncio.ensure_future(self._draw())
        await self._until(drawn.seconds - self._send_s)
        self.shown += 1
        self._returned = time.monotonic()
        return drawn

    async def close(self) -> None:
        """Stop drawing."""
        if self._drawing is not None:
            self._drawing.cancel()
            await asyncio.gather(self._drawing, return_exceptions=True)
        self._thread.shutdown(wait=False, cancel_futures=True)

    # ---- inside

    async def _draw(self) -> Picture:
        """Draw the first picture that can be ready in time.

        It is begun a picture early, so that a delayed one does not make the next late.
        """
        least = min(self._draw_s + self._send_s + SLACK_S, MOST_AHEAD_S)
        lead = min(least + 1 / self._rate, MOST_AHEAD_S)
        following = self._picture + 1
        index = max(following, math.ceil((self._now() + least) * self._rate))
        if following:
            self.skipped += index - following
        self._picture = index
        seconds = index / self._rate
        await self._until(seconds - lead)
        first, start = self._follow()
        at = start + max(0.0, seconds - first * BLOCK_S) * SAMPLE_RATE_HZ
        began = time.monotonic()
        pixels = await asyncio.get_running_loop().run_in_executor(self._thread, self._source.picture, at)
        self._draw_s += CALM * (time.monotonic() - began - self._draw_s)
        return Picture(seconds, pixels)

    def _follow(self) -> tuple[int, int]:
        """The place on the session's clock, as a block and its first sample, after a look at the playhead."""
        block, head = math.floor(self._now() / BLOCK_S), self._playhead()
        if self._anchor is None:
            self._anchor = block, head
        first, start = self._anchor
        at = start + max(0, block - first) * BLOCK_SAMPLES
        if abs(at - head) > self._far:
            self._anchor = block + 1, head
        elif at + BLOCK_SAMPLES + EDGE > self._source.end:
            self._anchor = block + 1, at
        return self._anchor

    def _now(self) -> float:
        """Time of the stream."""
        now = time.monotonic()
        if self._began is None:
            self._began = now
        return now - self._began

    async def _until(self, seconds: float) -> None:
        await asyncio.sleep(max(0.0, seconds - self._now()))


def _give_way() -> None:
    """Give the engine's threads precedence over this one, on systems that have priorities of threads."""
    if sys.platform == "linux":
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)


def doubled(samples: Int16[np.ndarray, " s"]) -> Int16[np.ndarray, " t"]:
    """Samples at twice the rate, without delay: 2 (s - 2 EDGE) of them, for all but EDGE samples at both ends.

    aiortc's own resampler holds back a packet, which would put sound 20 ms behind its picture.
    """
    count = len(samples) - 2 * EDGE
    twice = np.empty(2 * count)
    twice[::2] = samples[EDGE : EDGE + count]
    twice[1::2] = np.convolve(samples, _SINC / _SINC.sum(), "valid")[1 : 1 + count]
    return np.rint(np.clip(twice, -32_768, 32_767)).astype(np.int16)
