"""All sessions of a server: admission, resumption, expiry, and the alarms that advance them.

A session is advanced after an event of its own (a client's message, new motion, a fault) and at the deadline that
follows from its playhead. It is not polled in between.
"""

import asyncio
import logging
import secrets
import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from anyio import CapacityLimiter, create_task_group, to_thread
from jaxtyping import Float

from echoavatar import __version__
from echoavatar.engine import Engine, EngineThread
from echoavatar.engine.engine import give_back
from echoavatar.engine.manner import SET
from echoavatar.engine.music import Tracks
from echoavatar.engine.tools import Toolbox
from echoavatar.errors import AdmissionError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.guard import Admission
from echoavatar.wire.messages import VERSIONS, Flush, Hello, Latency, Ready, Rig, SoundFormat

from .clients import ClientLimits
from .metrics import Metrics
from .outbox import Outbox
from .session import ServerSession
from .settings import ServerSettings
from .sink_router import SinkRouter
from .waiting import RETRY_S, WaitingList

_LOG = logging.getLogger(__name__)
MOST_DECODERS = 2  # tracks decoded at the same time
STATS_S = 1.0
TRIM_S = 20.0  # between returns of freed memory to the system
DRAIN_S = 0.02  # between looks at sessions that are to end
GOODBYE_S = 3.0  # time for the last messages to every client


class SessionManager:
    """Owns the engine's threads. Everything but the model runs on one event loop."""

    def __init__(self, engine: Engine, settings: ServerSettings) -> None:
        self.engine, self.settings = engine, settings
        self.metrics = Metrics()
        self.metrics.seats.set(engine.seats)
        self.metrics.room.set_function(lambda: engine.room)
        self.tracks = Tracks(settings.music)
        self.admission = Admission(settings.connections, settings.connections_per_address)
        self.metrics.connections.set_function(lambda: self.connections)
        self.metrics.sessions.set_function(lambda: self.sessions)
        self.metrics.step.set_function(lambda: engine.step_seconds)
        self.clients = ClientLimits(settings.rates, settings.token)
        self.is_draining = False
        self._waiting = WaitingList()
        self._thread = EngineThread(engine)
        self._sessions: dict[str, ServerSession] = {}  # by public name
        self._keys: dict[str, ServerSession] = {}
        self._alarms: dict[str, asyncio.Handle] = {}  # by public name: the next call of `_advance`
        self.toolbox = Toolbox(engine.actions, self.tracks, has_manner=engine.pipeline.has_manner)
        self._tracing: Any = None  # `Tracing`, with its first session
        self._restarts = 0  # of the engine, as clients know them
        self._decoders = CapacityLimiter(MOST_DECODERS)
        self._actions = tuple(self.toolbox.meanings)
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
        """A session by its public name; the newest without one. Raises ProtocolError if there is no such session."""
        return self._known(self._sessions, name or next(reversed(self._sessions), ""))

    async def load_track(self, title: str) -> Float[np.ndarray, " s"]:
        """Decode a track, away from the event loop; raises what `Tracks.load` raises."""
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

        Raises ProtocolError: no common version, no such session, no seat, or the server is stopping.
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
            self._alarms.pop(session.name).cancel()
            self._sinks.follow(self._sessions.values())

    def _seat(self, hello: Hello) -> ServerSession:
        place = self._waiting.place(hello.ticket)
        if self.engine.free < place:
            lost = [session for session in self._sessions.values() if session.left_at is not None]
            if lost and self.engine.free + 1 >= place:
                self.end(min(lost, key=lambda session: session.left_at or 0.0))
        if self.engine.free < place:
            raise ProtocolError(
                "overloaded",
                f"this server carries {self.engine.room} sessions now, and all places are taken",
                retry_after=RETRY_S if hello.ticket else 5.0,
                place=place if hello.ticket else 0,
            )
        try:
            core = self.engine.open_core(
                seed=hello.seed,
                options=MotionOptions(**msgspec.structs.asdict(hello.body)),
                queue_seconds=self.settings.inbox_seconds,
                is_paced=True,
            )
        except AdmissionError as error:
            raise ProtocolError("overloaded", str(error), retry_after=5.0) from error
        self._waiting.leave(hello.ticket)
        session = ServerSession(
            core,
            name=secrets.token_urlsafe(12),
            key=secrets.token_urlsafe(24),
            hello=hello,
            settings=self.settings,
            actions=self._actions,
        )
        session.on_change = lambda: self._wake(session)
        core.on_motion = _on_loop(asyncio.get_running_loop(), session.on_change)
        if self.settings.tracer is not None:
            core.on_motion = self._trace(session, core.on_motion)
        self._sessions[session.name] = self._keys[session.key] = session
        self._wake(session)
        return session

    def _trace(self, session: ServerSession, collect: Callable[[], None]) -> Callable[[], None]:
        """Trace a session; returns the callback for its new motion."""
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
        """A message came after `ready`, so the source has the new key; the one that it resumed with is void now."""
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
            face=tuple(ARKIT_NAMES) if self.engine.pipeline.face is not None else (),
            actions=self._actions,
            tracks=self.tracks.titles,
            manner=tuple(SET) if self.engine.pipeline.has_manner else (),
            latency=Latency(algorithm=1e3 * self.engine.chunk.seconds, compute=1e3 * self.engine.step_seconds),
            limits=self.settings.limits,
            sound=sound,
        )

    @property
    def rig(self) -> Rig:
        """The skeleton of all sessions."""
        rig = self.engine.skeleton.config
        return Rig(names=rig.names, parents=rig.parents, rest=rig.offsets)

    # ---- alarms

    async def run(self) -> None:
        """Serve until cancelled; starts and stops the engine's threads."""
        loop = asyncio.get_running_loop()
        self._thread.on_change = _on_loop(loop, self._watch)
        with self._thread:
            try:
                async with create_task_group() as tasks:
                    tasks.start_soon(_every, STATS_S, self._tell_stats)
                    tasks.start_soon(_every, TRIM_S, lambda: loop.run_in_executor(None, give_back))
            finally:
                self._sinks.close()
                for session in list(self._sessions.values()):
                    self.end(session)

    def _wake(self, session: ServerSession) -> None:
        """Advance a session as soon as the present event is handled; once, however often this is called."""
        if session.name in self._sessions:
            self._set_alarm(session, asyncio.get_running_loop().call_soon(self._advance, session))

    def _set_alarm(self, session: ServerSession, alarm: asyncio.Handle) -> None:
        if session.name in self._alarms:
            self._alarms[session.name].cancel()
        self._alarms[session.name] = alarm

    def _advance(self, session: ServerSession) -> None:
        """Bring a session to the present: send new motion, schedule the chunks that are due, set the next alarm."""
        try:
            if session.core.error is not None:
                raise session.core.error
            for seconds in session.collect():
                self.metrics.chunks.inc()
                self.metrics.latency.observe(seconds)
            is_due = session.keep_pace()
            deadline = session.deadline
        except Exception:
            self._lose(session)
            return
        if is_due and self.engine.is_batched:
            for other in [each for each in self._sessions.values() if each is not session]:
                try:
                    other.keep_pace(early=True)  # it joins the batch; its alarm stays
                except Exception:
                    self._lose(other)
        self._sinks.follow(self._sessions.values())
        if session.left_at is not None:
            expiry = session.left_at + self.settings.resume_seconds
            if time.monotonic() >= expiry:
                self.end(session)
                return
            deadline = min(expiry, deadline or expiry)
        if deadline is not None:
            loop = asyncio.get_running_loop()
            self._set_alarm(session, loop.call_later(max(0.0, deadline - time.monotonic()), self._advance, session))

    def _lose(self, session: ServerSession) -> None:
        """End a session after a fault; call it in the fault's `except`, which gives the log its traceback."""
        _LOG.exception("session %s failed", session.name, extra={"session": session.name})
        self.metrics.faults.inc()
        for outbox in list(session.listeners):
            outbox.fail(ProtocolError("internal", "the session is lost; begin a new one", retry_after=1.0))
        self.end(session)

    def _watch(self) -> None:
        """Tell clients of a restart of the engine; fail all sessions if it ended for good."""
        self._thread.watch()
        if self.engine.restarts > self._restarts:
            self.metrics.restarts.inc(self.engine.restarts - self._restarts)
            self._restarts = self.engine.restarts
            resumed = ProtocolError("internal", "the engine was restarted; the session is resumed", fatal=False)
            kept = [session for session in self._sessions.values() if session.core.error is None]
            for outbox in [box for session in kept for box in session.listeners]:
                outbox.warn(resumed)
        if self._thread.error is not None:
            for session in self._sessions.values():
                session.core.fail(RuntimeError("the engine has stopped"))

    def _tell_stats(self) -> None:
        self._watch()
        step_s = self.engine.step_seconds
        for session in self._sessions.values():
            for outbox in session.listeners:
                outbox.put(session.stats(step_s=step_s, sessions=self.sessions, dropped=outbox.dropped))

    async def drain(self) -> None:
        """Admit no more clients; end all sessions once their speech is played, or after `drain_seconds`."""
        self.is_draining = True
        goodbye = ProtocolError(
            "shutting_down", "the server is stopping", fatal=False, retry_after=self.settings.drain_seconds
        )
        for session in self._sessions.values():
            for outbox in session.listeners:
                outbox.warn(goodbye)
        for _ in range(round(self.settings.drain_seconds / DRAIN_S)):
            if all(session.is_quiet for session in self._sessions.values()):
                break
            await asyncio.sleep(DRAIN_S)
        for session in list(self._sessions.values()):
            for outbox in list(session.listeners):
                outbox.fail(ProtocolError("shutting_down", "the server stopped", retry_after=5.0))
        for _ in range(round(GOODBYE_S / DRAIN_S)):  # time for the connections to send why
            if not self.connections:
                break
            await asyncio.sleep(DRAIN_S)


def _on_loop(loop: asyncio.AbstractEventLoop, what: Callable[[], None]) -> Callable[[], None]:
    """A function that calls `what` on the event loop, from any thread."""

    def call() -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(what)

    return call


async def _every(seconds: float, what: Callable[[], object]) -> None:
    while True:
        await asyncio.sleep(seconds)
        what()
