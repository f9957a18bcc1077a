"""All sessions of a server: admission, resumption, expiry, and the clock that moves them."""

import asyncio
import logging
import secrets
import time
from collections.abc import Callable

import numpy as np
from anyio import CapacityLimiter, to_thread
from jaxtyping import Float

from echoavatar import __version__
from echoavatar.engine import Engine, EngineThread
from echoavatar.engine.tools import HIDDEN, Toolbox
from echoavatar.engine.tracks import Tracks
from echoavatar.errors import AdmissionError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar.wire import (
    VERSIONS,
    Hello,
    Latency,
    ProtocolError,
    Ready,
    Rig,
)

from .admission import Admission
from .metrics import Metrics
from .outbox import Outbox
from .session import ServerSession
from .settings import ServerSettings
from .sink_router import SinkRouter

_LOG = logging.getLogger(__name__)
BEAT_S = 0.02
MOST_DECODERS = 2  # tracks that are decoded at once
STATS_S = 1.0
GOODBYE_S = 3.0  # for the last messages to every client


class SessionManager:
    """Owns the engine's threads. Everything but the model runs on one event loop."""

    def __init__(self, engine: Engine, settings: ServerSettings) -> None:
        self.engine, self.settings = engine, settings
        self.metrics = Metrics()
        self.metrics.seats.set(engine.seats)
        self.tracks = Tracks(settings.music)
        self.admission = Admission(settings.connections, settings.connections_per_address)
        self.is_draining = False
        self._thread = EngineThread(engine)
        self._live: dict[str, ServerSession] = {}  # by public name
        self._keys: dict[str, ServerSession] = {}
        self.toolbox = Toolbox(engine.actions, self.tracks)
        self._decoders = CapacityLimiter(MOST_DECODERS)
        self._actions = tuple(name for name in engine.actions if name not in HIDDEN)
        self._sinks = SinkRouter(settings.sinks, self._rig())

    @property
    def connections(self) -> int:
        """How many WebSockets are open."""
        return len(self.admission)

    @property
    def sessions(self) -> int:
        """How many sessions there are."""
        return len(self._live)

    @property
    def names(self) -> tuple[str, ...]:
        """Public names of the sessions, the oldest first."""
        return tuple(self._live)

    def find(self, name: str = "") -> ServerSession:
        """A session by its public name; the newest without one.

        Raises:
            ProtocolError: there is no such session.
        """
        return self._known(self._live, name or next(reversed(self._live), ""))

    async def load_track(self, title: str) -> Float[np.ndarray, " s"]:
        """Decode a track, away from the event loop.

        Raises:
            EchoAvatarError: no such title, or a file that cannot be read.
        """
        return await to_thread.run_sync(self.tracks.load, title, limiter=self._decoders)

    @property
    def is_well(self) -> bool:
        """Whether the engine runs."""
        return self._thread.is_alive

    @property
    def has_failed(self) -> bool:
        """Whether the engine failed."""
        return self._thread.error is not None

    # ---- admission

    def enter(self, hello: Hello, outbox: Outbox) -> tuple[ServerSession, Ready]:
        """Open a session, resume one, or let a viewer in; nothing is queued before the `ready`.

        Raises:
            ProtocolError: no common version, no such session, no seat, or the server is stopping.
        """
        version = max(set(hello.versions) & set(VERSIONS), default=None)
        if version is None:
            raise ProtocolError(
                "unsupported_version",
                f"this server speaks versions {list(VERSIONS)}, not {list(hello.versions)}",
            )
        if self.is_draining:
            raise ProtocolError("shutting_down", "the server is stopping", retry_after=5.0)
        received: int | None = None
        if hello.role == "viewer":
            live = self._known(self._live, hello.session)
        elif hello.resume:
            live, received = self._known(self._keys, hello.resume), hello.played
            self._replace(live)
            self.metrics.resumed.inc()
        else:
            live = self._seat(hello)
        ready = self._ready(live, hello, version, received)
        outbox.put(ready)
        live.join(outbox, received=received)
        if hello.role == "source":
            live.source, live.left_at = outbox, None
        return live, ready

    def leave(self, live: ServerSession, outbox: Outbox, *, for_good: bool) -> None:
        """A connection is closed; the session ends with it if its source left for good."""
        was_source = live.source is outbox
        live.leave(outbox)
        self.metrics.dropped.inc(outbox.dropped)
        if was_source and for_good:
            self.end(live)

    def end(self, live: ServerSession) -> None:
        """End a session and all its connections."""
        if self._live.pop(live.name, None) is not None:
            del self._keys[live.key]
            live.close()
            self.metrics.sessions.set(self.sessions)

    def _seat(self, hello: Hello) -> ServerSession:
        if self.engine.free == 0:
            lost = [live for live in self._live.values() if live.left_at is not None]
            if lost:
                self.end(min(lost, key=lambda live: live.left_at or 0.0))
        try:
            core = self.engine.open_core(seed=hello.seed, inbox_seconds=self.settings.inbox_seconds, is_paced=True)
        except AdmissionError as error:
            raise ProtocolError("overloaded", f"all {self.engine.seats} seats are taken", retry_after=5.0) from error
        live = ServerSession(
            core,
            name=secrets.token_urlsafe(12),
            key=secrets.token_urlsafe(24),
            hello=hello,
            settings=self.settings,
            actions=self._actions,
        )
        core.on_motion = _on_loop(asyncio.get_running_loop(), lambda: self._collect(live))
        self._live[live.name] = self._keys[live.key] = live
        self.metrics.sessions.set(self.sessions)
        return live

    def _known(self, among: dict[str, ServerSession], name: str) -> ServerSession:
        live = among.get(name)
        if live is None:
            raise ProtocolError("unknown_session", "that session is not here, or is over; begin a new one")
        return live

    def _replace(self, live: ServerSession) -> None:
        """The source comes back over another connection; the old one ends."""
        if live.source is not None:
            old = live.source
            live.leave(old)
            old.fail(ProtocolError("replaced", "the session goes on over another connection"))

    def _ready(self, live: ServerSession, hello: Hello, version: int, received: int | None) -> Ready:
        return Ready(
            version=version,
            server=f"echoavatar {__version__} {self.settings.name}".strip(),
            session=live.name,
            resume=live.key if hello.role == "source" else "",
            resumed=received is not None,
            at=live.first_for(received),
            epoch=live.epoch,
            seg=live.speech.seg,
            received=live.speech.received,
            sample_rate=SAMPLE_RATE_HZ,
            frame_rate=FRAME_RATE_HZ,
            chunk_samples=self.engine.chunk.samples,
            rig=self._rig(),
            face=tuple(ARKIT_NAMES) if getattr(self.engine.pipeline, "face", None) is not None else (),
            actions=self._actions,
            tracks=self.tracks.titles,
            latency=Latency(algorithm=1e3 * self.engine.chunk.seconds, compute=1e3 * self.engine.step_seconds),
            limits=self.settings.limits,
        )

    def _rig(self) -> Rig:
        rig = self.engine.pipeline.skeleton.config
        return Rig(names=rig.names, parents=rig.parents, rest=rig.offsets)

    # ---- the clock

    async def run(self) -> None:
        """Move all sessions until cancelled; starts and stops the engine's threads."""
        beat = 0
        with self._thread:
            try:
                while True:
                    self._beat(with_stats=beat % round(STATS_S / BEAT_S) == 0)
                    beat += 1
                    await asyncio.sleep(BEAT_S)
            finally:
                self._sinks.close()
                for live in list(self._live.values()):
                    self.end(live)

    def _beat(self, *, with_stats: bool) -> None:
        """Move all sessions by the time since the last beat."""
        now, step_s = time.monotonic(), self.engine.step_seconds
        due = [self._is_due(live, now, step_s) for live in self._live.values()]
        for live in list(self._live.values()):
            self._move(live, now, early=any(due), with_stats=with_stats)
        self._sinks.show(self._live.values(), now)

    async def drain(self) -> None:
        """Admit no more clients; end all sessions once their speech is played, or after `drain_seconds`."""
        self.is_draining = True
        goodbye = ProtocolError(
            "shutting_down", "the server is stopping", fatal=False, retry_after=self.settings.drain_seconds
        )
        for live in self._live.values():
            for outbox in live.listeners:
                outbox.warn(goodbye)
        for _ in range(round(self.settings.drain_seconds / BEAT_S)):
            if all(live.is_quiet for live in self._live.values()):
                break
            await asyncio.sleep(BEAT_S)
        for live in list(self._live.values()):
            for outbox in list(live.listeners):
                outbox.fail(ProtocolError("shutting_down", "the server stopped", retry_after=5.0))
        for _ in range(round(GOODBYE_S / BEAT_S)):  # time for the connections to send why
            if not self.connections:
                break
            await asyncio.sleep(BEAT_S)

    def _is_due(self, live: ServerSession, now: float, step_s: float) -> bool:
        try:
            return live.is_due(now, step_s)
        except Exception:
            return False  # `_move` will fail in the same way, and end the session

    def _move(self, live: ServerSession, now: float, *, early: bool, with_stats: bool) -> None:
        try:
            if not self._thread.is_alive:
                raise RuntimeError("the engine's thread has ended")
            live.pump(now, self.engine.step_seconds, early=early)
            self._collect(live)
        except Exception:
            _LOG.exception("session %s failed", live.name)
            for outbox in list(live.listeners):
                outbox.fail(ProtocolError("internal", "the session failed; see the server's log"))
            self.end(live)
            return
        if live.left_at is not None and now - live.left_at > self.settings.resume_seconds:
            self.end(live)
        elif with_stats:
            for outbox in live.listeners:
                outbox.put(live.stats(step_s=self.engine.step_seconds, sessions=self.sessions, dropped=outbox.dropped))
            self.metrics.step.set(self.engine.step_seconds)

    def _collect(self, live: ServerSession) -> None:
        if live.name not in self._live:
            return
        for seconds in live.collect():
            self.metrics.chunks.inc()
            self.metrics.latency.observe(seconds)


def _on_loop(loop: asyncio.AbstractEventLoop, what: Callable[[], None]) -> Callable[[], None]:
    """The same call, from an engine's thread onto the event loop."""

    def call() -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(what)

    return call
