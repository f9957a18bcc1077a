"""The settings of a server."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import msgspec

from echoavatar.wire.messages import Limits

from .clients import ClientRates


@dataclass(frozen=True)
class ServerSettings:
    """Everything that an operator decides, except the number of seats, which is the engine's."""

    name: str = ""  # tells this server from others, sent in `ready`
    token: str = ""  # empty: clients need none
    origins: tuple[str, ...] = ()  # pages of other hosts that may connect, such as https://avatar.example.org
    inbox_seconds: float = 120.0  # speech that may wait
    ahead_seconds: float = 2.0  # motion ahead of playback, at most; the engine can take back 4 s
    resume_seconds: float = 30.0  # how long a session waits for its source
    ping_seconds: float = 30.0  # a client that sends nothing for twice as long is closed
    hello_seconds: float = 10.0  # a client must send hello in this time
    drain_seconds: float = 10.0  # at shutdown, for speech to end
    connections: int = 256  # WebSockets at once, sources and viewers
    connections_per_address: int = 64  # WebSockets at once from one address
    rates: ClientRates = field(default_factory=ClientRates)  # how often one client may ask
    proxies: tuple[str, ...] = ()  # addresses or networks whose X-Forwarded-For is believed
    lists_sessions: bool = True  # whether clients may ask for names of sessions; strangers who share a server may not
    music: Path | None = None  # folder of further tracks
    tracer: Any = None  # an OpenTelemetry `Tracer` that gets spans of every chunk, see `tracing`
    video: int = 0  # WebRTC viewers at once, each with a renderer; 0: no video
    video_size: tuple[int, int] = (512, 512)  # pixels
    video_renderer: Literal["cpu", "gpu"] = "cpu"  # rasteriser on the processor, or OpenGL
    ice_servers: tuple[str, ...] = ()  # STUN or TURN, for viewers behind other networks' routers
    sinks: tuple[str, ...] = ()  # programs that show the first session's avatar, such as vmc://127.0.0.1:39539

    @property
    def limits(self) -> Limits:
        """The limits that `ready` tells clients."""
        return msgspec.convert(self, Limits, from_attributes=True)
