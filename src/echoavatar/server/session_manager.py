"""All sessions of a server: admission, resumption, expiry, and the loop that advances them."""

import asyncio
import logging
import secrets
import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from anyio import CapacityLimiter, to_thread
from jaxtyping import Float

from echoavatar import __version__
from echoavatar.engine import Engine, EngineThread
from echoavatar.engine.tools import HIDDEN, Toolbox
from echoavatar.engine.tracks import Tracks
from echoavatar.errors import AdmissionError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar.wire import VERSIONS, Flush, Hello, Latency, ProtocolError, Ready, Rig
from echoavatar.wire.messages import SoundFormat

from . import memory
from .admission import Admission
from .metrics import Metrics
from .outbox import Outbox
from .session import ServerSession
from .settings import ServerSettings
from .sink_router import SinkRouter

_LOG = logging.getLogger(__name__)
BEAT_S = 0.02
MOST_DECODERS = 2  # tracks decoded at the same time
STATS_S = 1.0
TRIM_S = 20.0  # between returns of freed memory
GOODBYE_S = 3.0  # time for the last messages to every client


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
        self._sessions: dict[str, ServerSession] = {}  # by public name
        self._keys: dict[str, ServerSession] = {}
        self.toolbox = Toolbox(engine.actions, self.tracks)
        self._tracing: Any = None  # `Tracing`, with its first session
        self._restarts = 0  # of the engine, as clients know them
        self._decoders = CapacityLimiter(MOST_DECODERS)
        self._actions = tuple(name for name in engine.actions if name not in HIDDEN)
        self._sinks = SinkRouter(settings.sinks, self.rig)

    @property
    def connections(self) -> int:
        """How many WebSockets are open."""
        return len(self.admission)

    @property
    def sessions(self) -> int:
        """How many sessions there are."""
        return len(self._sessions)

    @property
    def names(self) -> tuple[str, ...]:
        """Public names of the sessions, the oldest first."""
        return tuple(self._sessions)

    def find(self, name: str = "") -> ServerSession:
        """A session by its public name; the newest without one.

        Raises:
            ProtocolError: there is no such session.
        """
        return self._known(self._sessions, name or next(reversed(self._sessions), ""))

    async def load_track(self, title: str) -> Float[np.ndarray, " s"]:
        """Decode a track, away from the event loop.

        Raises:
            EchoAvatarError: no such title, or a file that cannot be read.
        """
        return await to_thread.run_sync(self.tracks.load, title, limiter=self._decoders)

    @property
    def is_well(self) -> bool:
        """Whether the engine runs; not while it is restarted."""
        return self._thread.is_alive and self.engine.fault is None

    @property
    def failure(self) -> BaseException | None:
        """The fault after which the engine is not restarted any more."""
        return self._thread.error

    # ---- admission

    def enter(self, hello: Hello, outbox: Outbox) -> ServerSession:
        """Open a session, resume one, or admit a viewer. `ready` is the first message that is queued.

        Raises:
            ProtocolError: no common version, no such session, no seat, or the server is stopping.
        """
        version = max(set(hello.versions) & set(VERSIONS), default=None)
        if version is None:
            raise ProtocolError(
                "unsupported_version", f"this server speaks versions {list(VERSIONS)}, not {list(hello.versions)}"
            )
        if self.is_draining:
            raise ProtocolError("shutting_down", "the server is stopping", retry_after=5.0)
        received: int | None = None
        flush: Flush | None = None
        if hello.role == "viewer":
            session = self._known(self._sessions, hello.session)
        elif hello.resume:
            session, received = self._known(self._keys, hello.resume), hello.played
            if (flush := session.missed_flush(hello.epoch)) is not None:
                received = min(received, flush.at)
            self._replace(session)
            self._renew(session, hello.resume)
            self.metrics.resumed.inc()
        else:
            session = self._seat(hello)
        outbox.put(self._ready(session, hello, version, received, outbox.sound))
        if flush is not None:
            outbox.put(flush)
        session.join(outbox, received=received)
        if hello.role == "source":
            session.source, session.left_at = outbox, None
        return session

    def leave(self, session: ServerSession, outbox: Outbox, *, for_good: bool) -> None:
        """A connection is closed; the session ends with it if its source left for good."""
        was_source = session.source is outbox
        session.leave(outbox)
        self.metrics.dropped.inc(outbox.dropped)
        if was_source and for_good:
            self.end(session)

    def end(self, session: ServerSession) -> None:
        """End a session and all its connections."""
        if self._sessions.pop(session.name, None) is not None:
            self._keep_keys(session)
            session.close()
            self.metrics.sessions.set(self.sessions)

    def _seat(self, hello: Hello) -> ServerSession:
        if self.engine.free == 0:
            lost = [session for session in self._sessions.values() if session.left_at is not None]
            if lost:
                self.end(min(lost, key=lambda session: session.left_at or 0.0))
        try:
            core = self.engine.open_core(
                seed=hello.seed,
                options=MotionOptions(**msgspec.structs.asdict(hello.body)),
                queue_seconds=self.settings.inbox_seconds,
                is_paced=True,
            )
        except AdmissionError as error:
            raise ProtocolError("overloaded", f"all {self.engine.seats} seats are taken", retry_after=5.0) from error
        session = ServerSession(
            core,
            name=secrets.token_urlsafe(12),
            key=secrets.token_urlsafe(24),
            hello=hello,
            settings=self.settings,
            actions=self._actions,
        )
        collect = _on_loop(asyncio.get_running_loop(), lambda: self._collect(session))
        core.on_motion = collect
        if self.settings.tracer is not None:
            core.on_motion = self._trace(session, collect)
        self._sessions[session.name] = self._keys[session.key] = session
        self.metrics.sessions.set(self.sessions)
        return session

    def _trace(self, session: ServerSession, collect: Callable[[], None]) -> Callable[[], None]:
        """Trace a session; returns what to do after each of its chunks."""
        from .tracing import SessionTrace, Tracing

        self._tracing = self._tracing or Tracing(self.engine, self.settings.tracer)
        trace, core = SessionTrace(self._tracing, session.name), session.core
        session.trace = trace

        def note() -> None:
            trace.made(core.made - core.chunk.samples)
            collect()

        return note

    def _known(self, among: dict[str, ServerSession], name: str) -> ServerSession:
        session = among.get(name)
        if session is None:
            raise ProtocolError("unknown_session", "that session is not here, or has ended; begin a new one")
        return session

    def confirm(self, session: ServerSession, outbox: Outbox) -> None:
        """The source has spoken after its `ready`, so it has the new key: the one that it resumed with is spent."""
        if session.is_renewed and session.source is outbox:
            self._keep_keys(session, session.key)
            session.is_renewed = False

    def _renew(self, session: ServerSession, used: str) -> None:
        """Give a session that is resumed a new key; the one used stays, in case `ready` is lost on the way."""
        session.key, session.is_renewed = secrets.token_urlsafe(24), True
        self._keys[session.key] = session
        self._keep_keys(session, used, session.key)

    def _keep_keys(self, session: ServerSession, *kept: str) -> None:
        for key in [key for key, known in self._keys.items() if known is session and key not in kept]:
            del self._keys[key]

    def _replace(self, session: ServerSession) -> None:
        """End the connection of a source that resumes over another one."""
        if session.source is not None:
            old = session.source
            session.leave(old)
            old.fail(ProtocolError("replaced", "the session goes on over another connection"))

    def _ready(
        self, session: ServerSession, hello: Hello, version: int, received: int | None, sound: SoundFormat
    ) -> Ready:
        return Ready(
            version=version,
            server=f"echoavatar {__version__} {self.settings.name}".strip(),
            session=session.name,
            resume=session.key if hello.role == "source" else "",
            resumed=received is not None,
            at=session.first_for(received),
            epoch=session.epoch,
            seg=session.speech.seg,
            received=session.speech.received,
            sample_rate=SAMPLE_RATE_HZ,
            frame_rate=FRAME_RATE_HZ,
            chunk_samples=self.engine.chunk.samples,
            rig=self.rig,
            face=tuple(ARKIT_NAMES) if getattr(self.engine.pipeline, "face", None) is not None else (),
            actions=self._actions,
            tracks=self.tracks.titles,
            latency=Latency(algorithm=1e3 * self.engine.chunk.seconds, compute=1e3 * self.engine.step_seconds),
            limits=self.settings.limits,
            sound=sound,
        )

    @property
    def rig(self) -> Rig:
        """The skeleton of all sessions."""
        rig = self.engine.pipeline.skeleton.config
        return Rig(names=rig.names, parents=rig.parents, rest=rig.offsets)

    # ---- the clock

    async def run(self) -> None:
        """Advance all sessions until cancelled; starts and stops the engine's threads."""
        beat = 0
        with self._thread:
            try:
                while True:
                    self._beat(with_stats=beat % round(STATS_S / BEAT_S) == 0)
                    beat += 1
                    if beat % round(TRIM_S / BEAT_S) == 0:
                        asyncio.get_running_loop().run_in_executor(None, memory.give_back)
                    await asyncio.sleep(BEAT_S)
            finally:
                self._sinks.close()
                for session in list(self._sessions.values()):
                    self.end(session)

    def _beat(self, *, with_stats: bool) -> None:
        """Advance all sessions to the present."""
        self._thread.watch()
        now, step_s = time.monotonic(), self.engine.step_seconds
        if self.engine.restarts > self._restarts:
            self.metrics.restarts.inc(self.engine.restarts - self._restarts)
            self._restarts = self.engine.restarts
            resumed = ProtocolError("internal", "the engine was restarted; the session is resumed", fatal=False)
            kept = [session for session in self._sessions.values() if session.core.error is None]
            for outbox in [box for session in kept for box in session.listeners]:
                outbox.warn(resumed)
        due = [self._is_due(session, now, step_s) for session in self._sessions.values()]
        for session in list(self._sessions.values()):
            self._move(session, now, early=any(due), with_stats=with_stats)
        self._sinks.show(self._sessions.values(), now)

    async def drain(self) -> None:
        """Admit no more clients; end all sessions once their speech is played, or after `drain_seconds`."""
        self.is_draining = True
        goodbye = ProtocolError(
            "shutting_down", "the server is stopping", fatal=False, retry_after=self.settings.drain_seconds
        )
        for session in self._sessions.values():
            for outbox in session.listeners:
                outbox.warn(goodbye)
        for _ in range(round(self.settings.drain_seconds / BEAT_S)):
            if all(session.is_quiet for session in self._sessions.values()):
                break
            await asyncio.sleep(BEAT_S)
        for session in list(self._sessions.values()):
            for outbox in list(session.listeners):
                outbox.fail(ProtocolError("shutting_down", "the server stopped", retry_after=5.0))
        for _ in range(round(GOODBYE_S / BEAT_S)):  # time for the connections to send why
            if not self.connections:
                break
            await asyncio.sleep(BEAT_S)

    def _is_due(self, session: ServerSession, now: float, step_s: float) -> bool:
        try:
            return session.is_due(now, step_s)
        except Exception:
            return False  # `_move` will fail in the same way, and end the session

    def _move(self, session: ServerSession, now: float, *, early: bool, with_stats: bool) -> None:
        try:
            if not self._thread.is_alive:
                raise RuntimeError("the engine has stopped")
            if session.core.error is not None:
                raise session.core.error
            session.pump(now, self.engine.step_seconds, early=early)
            self._collect(session)
        except Exception:
            _LOG.exception("session %s failed", session.name, extra={"session": session.name})
            self.metrics.faults.inc()
            for outbox in list(session.listeners):
                outbox.fail(ProtocolError("internal", "the session is lost; begin a new one", retry_after=1.0))
            self.end(session)
            return
        if session.left_at is not None and now - session.left_at > self.settings.resume_seconds:
            self.end(session)
        elif with_stats:
            for outbox in session.listeners:
                outbox.put(
                    session.stats(step_s=self.engine.step_seconds, sessions=self.sessions, dropped=outbox.dropped)
                )
            self.metrics.step.set(self.engine.step_seconds)

    def _collect(self, session: ServerSession) -> None:
        if session.name not in self._sessions:
            return
        for seconds in session.collect():
            self.metrics.chunks.inc()
            self.metrics.latency.observe(seconds)


def _on_loop(loop: asyncio.AbstractEventLoop, what: Callable[[], None]) -> Callable[[], None]:
    """A function that calls `what` on the event loop, from any thread."""

    def call() -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(what)

    return call
