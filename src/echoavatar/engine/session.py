"""A session is three verbs: `push(audio)`, `clear()`, and iterate motion."""

from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..audio import StreamResampler
from ..errors import EchoAvatarError
from ..pipeline import MotionChunk
from ..timing import CHUNK_SAMPLES, SAMPLE_RATE_HZ

if TYPE_CHECKING:
    from .engine import Engine

INBOX_SECONDS = 600  # agents deliver speech faster than real time; more than this waiting is a mistake


class Session:
    """One listener's stream: audio in at any rate, motion out at 30 fps, in order.

    Open one with `Engine.open`; use it as a context manager, or `close` it, to free its seat.
    """

    def __init__(self, engine: "Engine", seat: int, *, seed: int) -> None:
        self.seat = seat
        self.seed = seed
        self._engine = engine
        self._resampler: StreamResampler | None = None
        self._waiting = np.zeros(0, np.float32)
        self._out: deque[MotionChunk] = deque()
        self._pushed = 0
        self._finished = False
        self._closed = False

    @property
    def waiting(self) -> bool:
        """Whether a whole chunk of audio is there to be turned into motion."""
        return len(self._waiting) >= CHUNK_SAMPLES

    def push(self, audio: Float[np.ndarray, "..."], rate: int = SAMPLE_RATE_HZ) -> None:
        """Add audio: mono (s,) or (s, channels), float in [-1, 1] or int16, at any sample rate.

        Raises:
            AudioError: values that are not finite, or a rate that cannot be.
            EchoAvatarError: more than ten minutes are waiting, or the session is finished.
        """
        if self._finished or self._closed:
            raise EchoAvatarError("this session is finished; open a new one to push more audio")
        if self._resampler is None or self._resampler.rate != rate:
            self._flush()
            self._resampler = StreamResampler(rate)
        samples = self._resampler.push(audio)
        if len(self._waiting) + len(samples) > INBOX_SECONDS * SAMPLE_RATE_HZ:
            raise EchoAvatarError(
                f"more than {INBOX_SECONDS} s of audio are waiting; read motion from the session before pushing more"
            )
        self._waiting = np.concatenate([self._waiting, samples])
        self._pushed += len(samples)

    def stall(self) -> None:
        """The source is late: complete the chunk in hand with silence, so that idle life goes on."""
        missing = CHUNK_SAMPLES - len(self._waiting)
        if missing > 0:
            self._waiting = np.concatenate([self._waiting, np.zeros(missing, np.float32)])

    def clear(self) -> None:
        """Forget audio that was pushed but not yet turned into motion, and motion not yet taken (barge-in)."""
        self._resampler = None
        self._waiting = np.zeros(0, np.float32)
        self._out.clear()

    def finish(self) -> None:
        """No more audio will come: the rest is completed with silence to a whole chunk."""
        if not self._finished:
            self._flush()
            if len(self._waiting) % CHUNK_SAMPLES:
                self._waiting = np.pad(self._waiting, (0, -len(self._waiting) % CHUNK_SAMPLES))
            self._finished = True

    def close(self) -> None:
        """Free the seat."""
        if not self._closed:
            self._closed = True
            self._engine.release(self)

    def take(self) -> MotionChunk | None:
        """The next chunk of motion that is ready, or None."""
        return self._out.popleft() if self._out else None

    def __iter__(self) -> Iterator[MotionChunk]:
        """Chunks of motion until the audio pushed so far is used up; ticks the engine as needed."""
        while True:
            if self._out:
                yield self._out.popleft()
            elif self.waiting and not self._closed:
                self._engine.tick()
            else:
                return

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def next_chunk(self) -> Float[np.ndarray, " 6400"]:
        """Take the oldest waiting chunk of audio; the engine calls this when the session is `waiting`."""
        chunk, self._waiting = self._waiting[:CHUNK_SAMPLES], self._waiting[CHUNK_SAMPLES:]
        return chunk

    def deliver(self, chunk: MotionChunk) -> None:
        """Queue a chunk of motion for the reader; the engine calls this."""
        self._out.append(chunk)

    def _flush(self) -> None:
        if self._resampler is not None:
            self._waiting = np.concatenate([self._waiting, self._resampler.flush()])
            self._resampler = None
