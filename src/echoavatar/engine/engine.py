"""Many sessions over one pipeline: each owns one row of its state. Chunks are made in `tick` and `work` only.

A worker claims a session's seat before it steps it, so several threads may call either at once.

A step that fails leaves each row as it was before. `tick` raises the fault. `work` finds the session that causes it.
If the pipeline cannot step silence either, `fault` holds it, and no session is stepped until `restart`. Else each
session is tried once more by itself; one that fails again gets an `error` and is not stepped any more.
"""

import ctypes
import logging
import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from echoavatar.errors import AdmissionError, EchoAvatarError
from echoavatar.models.generator.config import Precision
from echoavatar.models.generator.manner import TOLD
from echoavatar.motion import homecoming, idle_motion
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.nn.device import threads

from .audio_queue import QUEUE_SECONDS
from .pipeline import Pipeline, load_bundle
from .pipeline.undo import changes, undo
from .session import Session
from .session_core import SessionCore

_LOG = logging.getLogger(__name__)
REWIND = 15  # chunks, 4 s at the paper's step: how far a session can go back


class Engine:
    """The sessions of one pipeline. `EngineThread` calls `work`, scripts call `tick`."""

    def __init__(
        self,
        pipeline: Pipeline,
        *,
        seats: int = 1,
        look_ahead: int | None = None,
        rewind: int = REWIND,
        workers: int | None = None,
        reload: Callable[[], Pipeline] | None = None,
    ) -> None:
        """`look_ahead` bounds the chunks made ahead of the player, or of the reader if the player does not report.

        `rewind` is how many chunks a session can take back; each costs 0.4 MB with the default bundle.

        `workers` threads step sessions side by side, each session by itself (default: `nn.device.threads`, or 0 if the
        models are on a GPU). 0 steps all sessions as one batch. A CPU spends as much on a row of a batch as on a row
        alone, and a batch would make a session that is ready wait for the others; a GPU spends hardly more on a batch
        than on a row.

        `reload` makes the pipeline anew for `restart`; without it, the same one goes on.
        """
        if seats < 1:
            raise EchoAvatarError(f"an engine needs at least one seat, got {seats}")
        if look_ahead is not None and look_ahead < 1:
            raise EchoAvatarError(f"look_ahead must be at least one chunk, got {look_ahead}")
        self.pipeline = pipeline
        self.chunk, self.actions, self.additions = pipeline.chunk, pipeline.actions, pipeline.additions
        self.step_seconds = 0.0  # duration of the last step
        self.busy_seconds = 0.0  # duration of all steps
        self.fault: Exception | None = None  # why the pipeline cannot make a step any more
        self.restarts = self.wakes = 0
        self.on_step: Callable[[Pipeline], None] = lambda pipeline: None  # called when a step begins, in its thread
        self._reload = reload or (lambda: pipeline)
        self._codes = pipeline.directive_codes
        self._state = pipeline.init_state(seats)
        self._sessions: dict[int, SessionCore] = {}  # by seat, the session that was stepped last at the end
        self._claimed: dict[int, float] = {}  # seats that a thread works on, and since when
        self.seats = seats  # how many sessions there can be
        self._look_ahead, self._rewind = look_ahead, rewind
        own_workers = threads() if pipeline.device == "cpu" else 0
        self._workers = own_workers if workers is None else workers
        self.is_batched = self._workers == 0  # sessions are stepped together, and one more in a step costs hardly more
        self.workers = max(1, self._workers)  # threads that can make use of `work`
        self._pool = ThreadPoolExecutor(self._workers, "worker") if self._workers > 1 else None
        self._lock, self._awake = threading.RLock(), threading.Condition()

    @property
    def skeleton(self) -> Skeleton:
        """The rig of all sessions."""
        return self.pipeline.skeleton

    @property
    def free(self) -> int:
        """How many more sessions can be opened now."""
        return self.seats - len(self._sessions)

    def open(self, *, seed: int = 0, options: MotionOptions = FREE) -> Session:
        """Open a session. Its motion depends on its seed and audio alone, not on its neighbours.

        `options` keep it in place, on a leash, or standing from the hips down.

        Raises:
            AdmissionError: all seats are taken.
        """
        return Session(self.open_core(seed=seed, options=options))

    def open_core(
        self,
        *,
        seed: int = 0,
        options: MotionOptions = FREE,
        queue_seconds: float = QUEUE_SECONDS,
        is_paced: bool = False,
    ) -> SessionCore:
        """As `open`, for servers: see `SessionCore`."""
        with self._lock:
            free = [seat for seat in range(self.seats) if seat not in self._sessions]
            if not free:
                raise AdmissionError(
                    f"all {self.seats} seats are taken; close a session or open the engine with more seats"
                )
            core = SessionCore(
                self,
                free[0],
                seed=seed,
                options=options,
                look_ahead=self._look_ahead,
                rewind=self._rewind,
                queue_seconds=queue_seconds,
                is_paced=is_paced,
            )
            self._sessions[core.seat] = core
            return core

    def release(self, core: SessionCore) -> None:
        """Free a session's seat; `SessionCore.close` calls this."""
        with self._lock:
            if self._sessions.get(core.seat) is core:
                del self._sessions[core.seat]

    def wake(self) -> None:
        """Tell waiting threads that a chunk may be due; sessions call this."""
        with self._awake:
            self.wakes += 1
            self._awake.notify_all()

    def wait(self, wakes: int, seconds: float) -> None:
        """Sleep until `wake` is called, at most `seconds`; not at all if `wake` was called since `wakes` was read."""
        with self._awake:
            self._awake.wait_for(lambda: self.wakes != wakes, seconds)

    def tick(self) -> int:
        """Step every session that is ready; return how many were. Raises what a step raises."""
        ready = self._claim(self.seats)
        groups = [[session] for session in ready] if self._workers else [ready] if ready else []
        list((self._pool.map if self._pool else map)(lambda group: self._step(group, self._make), groups))
        for session in ready:
            if session.error is not None:
                raise session.error
        return len(ready)

    def work(self) -> bool:
        """Step the session with the least motion ahead, or all that are ready as one batch; False if none is."""
        ready = self._claim(1 if self._workers else self.seats)
        if ready:
            self._step(ready, self._make_or_contain)
        return bool(ready)

    @property
    def is_busy(self) -> bool:
        """Whether a thread steps a session now."""
        return bool(self._claimed)

    @property
    def longest_step_s(self) -> float:
        """How long the oldest step that is not over has lasted; 0 if no session is stepped."""
        with self._lock:
            return max((time.monotonic() - since for since in self._claimed.values()), default=0.0)

    def restart(self) -> None:
        """Load the pipeline again after a `fault`, while no thread steps.

        Sessions go on from the last state of their rows; those whose rows cannot be read have an `error`. Raises what
        loading raises.
        """
        pipeline = self._reload()
        state = pipeline.init_state(self.seats)
        try:
            for new, old in zip(state.arrays(), self._state.arrays(), strict=True):
                new[:] = old
        except Exception as error:
            _LOG.exception("the states of the sessions are lost")
            for session in list(self._sessions.values()):
                session.fail(error)
        with self._lock:
            self.pipeline, self._state, self.fault = pipeline, state, None
            self.restarts += 1
        self.wake()

    def _claim(self, most: int) -> list[SessionCore]:
        """Claim sessions that are ready and that no thread works on, those with the least motion ahead first."""
        with self._lock:
            if self.fault is not None:
                return []
            idle = [session for seat, session in self._sessions.items() if seat not in self._claimed]
            ready = sorted((session for session in idle if session.is_ready), key=lambda session: session.ahead)[:most]
            for session in ready:
                self._claimed[session.seat] = time.monotonic()
                self._sessions[session.seat] = self._sessions.pop(session.seat)  # last among equals next time
        return ready

    def _step(self, ready: list[SessionCore], make: Callable[[list[SessionCore]], None]) -> None:
        """The next chunk of one session; or of several, in one batch of all seats."""
        began = time.perf_counter()
        self.on_step(self.pipeline)
        try:
            make(ready)
        finally:
            with self._lock:
                for session in ready:
                    del self._claimed[session.seat]
                self.step_seconds = time.perf_counter() - began
                self.busy_seconds += self.step_seconds
            if self._workers > 1:
                self.wake()  # another thread may step the next session

    def _make_or_contain(self, ready: list[SessionCore]) -> None:
        """Make a chunk of each session; a fault ends the session that causes it, or stops the engine."""
        try:
            self._make(ready)
            return
        except Exception as fault:
            _LOG.exception("a step failed")
            if not self._can_step():
                self.fault = fault
                return
        for session in ready:
            if session.is_ready:
                try:
                    self._make([session])
                except Exception as error:
                    session.fail(error)

    def _can_step(self) -> bool:
        """Whether the pipeline can make a chunk of silence."""
        try:
            silence, everyone = np.zeros((1, self.chunk.samples), np.float32), np.ones(1, np.bool_)
            self.pipeline.step(silence, self.pipeline.init_state(1), everyone)
        except Exception:
            return False
        return True

    def _make(self, ready: list[SessionCore]) -> None:
        seats = slice(0, self.seats) if len(ready) > 1 else slice(ready[0].seat, ready[0].seat + 1)
        rows = seats.stop - seats.start
        audio, active = np.zeros((rows, self.chunk.samples), np.float32), np.zeros(rows, np.bool_)
        members, is_asked, forgets = np.zeros((rows, self._codes), np.float32), False, np.zeros(rows, np.bool_)
        manner = np.full((rows, len(TOLD)), np.nan, np.float32)
        for session in ready:
            row = session.seat - seats.start
            if session.is_new:
                own, this = self._state.rows(slice(session.seat, session.seat + 1)), np.ones(1, np.bool_)
                self.pipeline.reset(own, this, seed=session.seed, options=session.options)
                session.is_new = False
            plan = session.begin_chunk(self._codes)
            for patches in plan.undone:  # a second time, after a fault, changes nothing more
                undo(patches, self._state, session.seat)
            audio[row], active[row], forgets[row] = plan.audio, True, plan.forgets
            manner[row] = plan.manner
            if plan.members is not None:
                members[row], is_asked = plan.members, True
        state = self._state.rows(seats)
        before = state.snapshot() if self._rewind else []
        try:
            if forgets.any():
                self.pipeline.restart_generator(state, forgets)
            told: dict[str, Any] = {"directive": self.pipeline.directive(members)} if is_asked else {}
            told |= {"manner": manner} if self.pipeline.has_manner else {}
            chunks = self.pipeline.step(audio, state, active, **told)
            undoing = [changes(before, state, s.seat - seats.start) if self._rewind else [] for s in ready]
        except Exception as fault:
            self._take_back(ready, state, before, active, fault)
            raise
        for session, patches in zip(ready, undoing, strict=True):
            with suppress(Exception):  # the session notes it as its error
                session.end_chunk(chunks[session.seat - seats.start], patches)

    def _take_back(
        self, ready: list[SessionCore], state: Any, before: list[Any], active: Bool[np.ndarray, " b"], fault: Exception
    ) -> None:
        """Restore the rows of a step that failed half-way; sessions that cannot be restored are lost."""
        try:
            if not before:
                raise fault
            state.restore(before, active)
        except Exception as error:
            for session in ready:
                session.fail(error)


def load(
    bundle: str | Path = "default",
    *,
    seats: int = 1,
    precision: Precision | None = None,
    look_ahead: int | None = None,
    device: str = "cpu",
    without: Collection[str] = (),
    runtime: str = "default",
) -> Engine:
    """An engine for a bundle: the name of a shipped one, or a folder. For `device` and `precision` see `Pipeline`.

    `without` names stages to leave out, see `Bundle.without`; `runtime` says what of ours runs, see `Runtime.chosen`.

    Raises:
        CheckpointError: the bundle is missing or damaged.
        EchoAvatarError: the device or a stage does not exist.
    """

    def build() -> Pipeline:
        pipeline = Pipeline(load_bundle(bundle).running(runtime).without(without), precision=precision, device=device)
        pipeline.warm_up()
        return pipeline

    pipeline = build()
    homecoming.warm_up(pipeline.skeleton)
    idle_motion.warm_up(pipeline.skeleton)
    with suppress(AttributeError, OSError, TypeError):  # glibc alone keeps what loading has freed, 190 MB, and has this
        ctypes.CDLL(None).malloc_trim(0)
    return Engine(pipeline, seats=seats, look_ahead=look_ahead, reload=build)
