"""What the owner of a server decides."""

from dataclasses import dataclass
from pathlib import Path

from ..wire import MAX_MESSAGE_BYTES, Limits


@dataclass(frozen=True)
class ServerSettings:
    """Seats are the engine's; everything else about a server."""

    name: str = ""  # of this server among several, told in `ready`
    token: str = ""  # empty: none is asked for
    origins: tuple[str, ...] = ()  # pages of other hosts that may connect, such as https://avatar.example.org
    inbox_seconds: float = 120.0  # sound that may wait
    ahead_seconds: float = 2.0  # motion ahead of playback, at most; the engine can take back 4 s
    resume_seconds: float = 30.0  # how long a session waits for its source
    ping_seconds: float = 30.0  # a client that says nothing for twice as long is gone
    hello_seconds: float = 10.0
    drain_seconds: float = 10.0  # at the end, for what is being said
    connections: int = 256  # at once, whatever they are
    lists_sessions: bool = True  # to whoever has the token; where strangers share a server, names are secrets
    music: Path | None = None  # folder of further tracks
    sinks: tuple[
        str, ...
    ] = ()  # programs that show the first session's avatar, such as vmc://127.0.0.1:39539

    @property
    def limits(self) -> Limits:
        """What clients are told of it."""
        return Limits(
            message_bytes=MAX_MESSAGE_BYTES,
            inbox_seconds=self.inbox_seconds,
            ahead_seconds=self.ahead_seconds,
            resume_seconds=self.resume_seconds,
            ping_seconds=self.ping_seconds,
        )
