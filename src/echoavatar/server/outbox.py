"""Messages that wait to be sent to one client. If they pile up, motion is dropped, then the connection is closed."""

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

import msgspec

from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.messages import Error, Motion, PackedSound, ServerMessage, Sound, SoundFormat, Stream

MOST_MOTION_S = 4.0
MOST_SOUND_S = 34.0
MOST_OTHER = 512  # messages


class Outbox:
    """A bounded queue of messages, filled and emptied on the event loop."""

    def __init__(self, wants: Iterable[Stream] = ("motion", "audio"), sound: SoundFormat = "pcm") -> None:
        self.sound = sound  # the format in which the client takes sound
        self.dropped = 0  # motion messages dropped so far
        self._wants = frozenset(wants)
        self._queue: deque[ServerMessage] = deque()
        self._filled = asyncio.Event()
        self._closed = False
        self.is_hopeless = False  # whether the connection is too slow for the sound
        self.error: ProtocolError | None = None  # why it was closed

    @property
    def plays(self) -> bool:
        """Whether the client plays the motion or sound that it receives."""
        return bool(self._wants)

    def __len__(self) -> int:
        return len(self._queue)

    def put(self, message: ServerMessage) -> None:
        """Queue a message, if the client wants it."""
        if self._closed or self.is_hopeless:
            return
        if isinstance(message, Motion):
            if "motion" not in self._wants:
                return
            earliest = message.at - MOST_MOTION_S * SAMPLE_RATE_HZ
            for old in [kept for kept in self._queue if isinstance(kept, Motion) and kept.at < earliest]:
                self._queue.remove(old)
                self.dropped += 1
        elif isinstance(message, Sound | PackedSound):
            if "audio" not in self._wants:
                return
            oldest = next((kept.at for kept in self._queue if isinstance(kept, Sound | PackedSound)), message.at)
            self.is_hopeless = message.at - oldest > MOST_SOUND_S * SAMPLE_RATE_HZ
        self._queue.append(message)
        self._filled.set()
        if len(self._queue) > MOST_OTHER:
            others = sum(not isinstance(kept, Motion | Sound | PackedSound) for kept in self._queue)
            self.is_hopeless = self.is_hopeless or others > MOST_OTHER

    def forget_after(self, at: int) -> None:
        """Drop motion and sound from clock `at` on, which were taken back."""
        self._queue = deque(
            message
            for message in self._queue
            if not (isinstance(message, Motion | Sound | PackedSound) and message.at >= at)
        )

    async def take(self) -> ServerMessage | None:
        """The next message; None if no more will come."""
        while not self._queue:
            if self._closed or self.is_hopeless:
                return None
            self._filled.clear()
            await self._filled.wait()
        return self._queue.popleft()

    def warn(self, error: ProtocolError) -> None:
        """Queue an error."""
        self.put(Error(code=error.code, message=str(error), fatal=error.fatal, retry_after=error.retry_after))

    def fail(self, error: ProtocolError) -> None:
        """Queue an error, and close the connection with its code."""
        self.warn(error)
        self.error = self.error or error
        self.close()

    def close(self) -> None:
        """Take no more messages; those in the queue are still sent."""
        self._closed = True
        self._filled.set()

    def clear(self) -> None:
        """The client is gone: drop all messages."""
        self._closed = True
        self._queue.clear()


class Relay(Outbox):
    """Passes a session's messages on at once; nothing is queued."""

    def __init__(
        self,
        take: Callable[[ServerMessage], None],
        has_source: Callable[[], bool],
        on_close: Callable[[], None] = lambda: None,
    ) -> None:
        """`take` receives each message, `has_source` says whether the session has a source now."""
        super().__init__()
        self._take, self._has_source, self._on_close = take, has_source, on_close

    @property
    def plays(self) -> bool:
        """Only while the session has a source: one that returns finds the session where it left it."""
        return self._has_source()

    def put(self, message: ServerMessage) -> None:
        """Pass a message on."""
        self._take(message)

    def close(self) -> None:
        """The session is over."""
        super().close()
        self._on_close()


class Sent(NamedTuple):
    """One chunk as it was sent."""

    motion: Motion
    sound: Sound
    packed: PackedSound | None  # the same sound as Opus, if a client takes that

    @property
    def end(self) -> int:
        """First sample after it."""
        return self.motion.at + self.motion.frames * SAMPLES_PER_FRAME

    def as_of(self, epoch: int) -> "Sent":
        """The same chunk for a client that joins in a later epoch, in which it is still valid."""
        renew = msgspec.structs.replace
        packed = None if self.packed is None else renew(self.packed, epoch=epoch)
        return Sent(renew(self.motion, epoch=epoch), renew(self.sound, epoch=epoch), packed)

    def put_into(self, outbox: Outbox) -> None:
        """Send to a client, the sound in the form that it takes."""
        outbox.put(self.motion)
        outbox.put(self.packed if self.packed is not None and outbox.sound == "opus" else self.sound)
