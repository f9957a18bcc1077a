"""A session, as users have it: push audio, interrupt it with `clear`, iterate motion."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import SAMPLE_RATE_HZ

from .action_scheduler import ActStatus
from .session_core import SessionCore


class SessionStatus(NamedTuple):
    """How a session is doing."""

    source: str  # of the latest motion: "action", "speech", "music" or "idle"
    is_listening: bool  # whether the user speaks, or has just stopped
    made: int  # samples at 24 kHz for which motion is made or being made
    seconds_waiting: float  # speech that the model has not heard yet
    late_chunks: int  # chunks that were made after their time had come


class Session:
    """One avatar: audio in at any rate, motion out at 30 fps, in order.

    Open one with `Engine.open`. Use it as a context manager, or `close` it, to free its seat. `core` is for the engine
    and for servers; it may change from release to release.
    """

    def __init__(self, core: SessionCore) -> None:
        self.core = core

    def push(self, audio: Float[np.ndarray, "..."], rate: int = SAMPLE_RATE_HZ) -> None:
        """Add audio: mono (s,) or (s, channels), float in [-1, 1] or int16, at any sample rate.

        Raises:
            AudioError: the samples or the rate are invalid.
            QueueFullError: more than ten minutes are waiting.
            EchoAvatarError: the session is finished or closed.
        """
        self.core.push(audio, rate)

    def words(self, words: Iterable[Sequence[Any]]) -> None:
        """Announce the words of the audio pushed next: (text, start) or (text, start, end), in seconds from its start.

        Some words begin a gesture that shows what they mean. `clear` drops the words that were not heard.

        Raises:
            EchoAvatarError: a word is too long, a time is wrong or out of order, or too many words wait.
        """
        self.core.add_words(words)

    def clear(self, heard: int | None = None) -> int:
        """Barge-in: forget audio after sample `heard` of the session, and all motion that stems from it.

        The motion goes on from the pose on screen as if the forgotten audio had never come. Without `heard`, the audio
        of all motion taken so far counts as heard. Returns the sample at which new motion begins. A session goes back
        as far as the engine remembers (`Engine(rewind=...)`).
        """
        return self.core.interrupt(heard).at

    def finish(self) -> None:
        """No more audio will come: silence completes the last chunk."""
        self.core.finish()

    def __iter__(self) -> Iterator[MotionChunk]:
        """Chunks of motion until the audio pushed so far is used up; makes them as needed.

        Raises:
            EchoAvatarError: the session has failed. The step that fails raises its own error.
        """
        while True:
            delivery = self.core.take()
            if delivery is not None:
                yield delivery.motion
            elif self.core.is_ready and not self.core.is_closed:
                self.core.advance()
            elif self.core.error is not None:
                raise EchoAvatarError(f"the session failed: {self.core.error}") from self.core.error
            else:
                return

    def listen(self, audio: Float[np.ndarray, "..."], rate: int = SAMPLE_RATE_HZ) -> None:
        """Sound of the user: the avatar looks up, listens and nods at pauses. It never becomes the avatar's speech.

        Raises:
            AudioError: the samples or the rate are invalid.
        """
        self.core.listen(audio, rate)

    def act(self, name: str, *, intensity: float = 1.0, hold_s: float | None = None) -> ActStatus:
        """Begin an action of the bundle's library with the next chunk. Never raises: it may be rejected."""
        return self.core.act(name, intensity=intensity, hold_s=hold_s)

    def set_manner(self, liveliness: float | None = None, handedness: float | None = None) -> None:
        """Change how the speaker gestures, 0 to 1 each; None leaves it as it is. See `MotionOptions`.

        Raises:
            ValueError: a number is out of range.
        """
        self.core.set_manner(liveliness, handedness)

    def play(self, title: str, track: Float[np.ndarray, " s"]) -> None:
        """Play music (24 kHz mono) under the speech; the avatar dances. EchoAvatarError: the session is closed."""
        self.core.play(title, track)

    def stop_music(self) -> None:
        """Fade the music out."""
        self.core.stop_music()

    @property
    def status(self) -> SessionStatus:
        """How the session is doing."""
        core = self.core
        return SessionStatus(core.source, core.is_listening, core.made, core.seconds_waiting, core.late)

    def close(self) -> None:
        """Free the seat."""
        self.core.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
