"""One session on a hand-wound clock: the engine is ticked, and time goes by, only where the test says so."""

import numpy as np
from tests.server.fakes import Body

from echoavatar.engine import Engine
from echoavatar.server.outbox import Outbox
from echoavatar.server.session import ServerSession
from echoavatar.server.settings import ServerSettings
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar.wire.blobs import pack_audio
from echoavatar.wire.messages import Audio, Hello, ServerMessage, Sound


class Told(Outbox):
    """Remembers what it was told."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[ServerMessage] = []

    def put(self, message: ServerMessage) -> None:
        self.told.append(message)

    def of(self, kind: type) -> list:  # type: ignore[type-arg]
        return [message for message in self.told if isinstance(message, kind)]


class Room:
    """An engine, a session, a listener, and a clock."""

    def __init__(self, **settings: float) -> None:
        self.engine = Engine(Body())  # type: ignore[arg-type]
        self.session = ServerSession(
            self.engine.open_core(queue_seconds=settings.get("inbox_seconds", 120.0), is_paced=True),
            name="s",
            key="k",
            hello=Hello(),
            settings=ServerSettings(**settings),  # type: ignore[arg-type]
            actions=("wave", "bow"),
            clock=lambda: self.now,
        )
        self.box = Told()
        self.now = 0.0
        self.session.join(self.box, received=None)

    def go(self, seconds: float, step: float = 0.05) -> None:
        for _ in range(max(1, round(seconds / step))):
            self.now += step
            self.beat()

    def beat(self) -> None:
        self.session.keep_pace()
        while self.engine.tick():
            pass
        self.session.collect()

    def speak(self, seg: int, seconds: float, level: float = 0.1, start: int = 0) -> None:
        pcm = pack_audio(np.full(round(seconds * 24_000), level, np.float32))
        self.session.hear(Audio(seg=seg, start=start, pcm=pcm))

    def sound(self) -> np.ndarray:
        """What a player plays: later parts win."""
        out = np.zeros(0)
        for message in self.box.of(Sound):
            pcm = np.frombuffer(message.pcm, "<i2") / 32_767
            out = np.concatenate([out[: message.at], pcm])
        return out

    def segs(self) -> dict[int, int]:
        """The utterance of each chunk on the clock."""
        return {message.at // CHUNK_SAMPLES: message.seg for message in self.box.of(Sound)}
