"""Many sessions over one pipeline: each owns one row of its state. Chunks are made in `tick` and `work` only.

A worker claims the seats of sessions before it steps them, so several threads may call either at once. It takes its
share of those that are ready, and steps them as one batch: the busier the machine, the larger the batches, and the less
a chunk costs. Where a row's sums would depend on its batch, a worker steps one session at a time.

A step that fails leaves each row as it was before. `tick` raises the fault. `work` finds the session that causes it.
If the pipeline cannot step silence either, `fault` holds it, and no session is stepped until `restart`. Else each
session is tried once more by itself; one that fails again gets an `error` and is not stepped any more.

A live session gets a seat only while the machine can carry one more (`Capacity`), so that nobody is late.
"""

import ctypes
import logging
import math
import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from echoavatar.errors import AdmissionError, EchoAvatarError
from echoavatar.models.generator.config import Precision
from echoavatar.models.generator.manner import TOLD
from echoavatar.motion import feeling, gaze, homecoming, idle_motion
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.motion.stages.stillness import WHOLE
from echoavatar.nn.device import threads

from .audio_queue import QUEUE_SECONDS
from .capacity import Capacity
from .pipeline import Pipeline, load_bundle
from .pipeline.undo import Rows
from .session import Session
from .session_core import SessionCore

_LOG = logging.getLogger(__name__)
REWIND_S = 4.0  # how far a session can go back
MEASURED = 8  # chunks that each worker makes to find out what one costs


class Engine:
    """The sessions of one pipeline. `EngineThread` calls `work`, scripts call `tick`."""

    def __init__(
        self,
        pipeline: Pipeline,
        *,
        seats: int = 1,
        look_ahead: int | None = None,
        rewind: int | None = None,
        workers: int | None = None,
        reload: Callable[[], Pipeline] | None = None,
    ) -> None:
        """`seats` is the most sessions at a time, `rewind` how many chunks one can take back (default: 4 s).

        `look_ahead` bounds the chunks made ahead of the player, or of the reader if the player does not report.

        `workers` threads step sessions side by side (default: `nn.device.threads`, or 0 if the models are on a GPU).
        0 steps all rows in every batch, also those that are not ready: a GPU spends hardly more on them, and runs a
        graph that it captured for that size.

        `reload` makes the pipeline anew for `restart`; without it, the same one goes on. EchoAvatarError: `seats` or
        `look_ahead` is less than 1.
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
        self._rows = Rows(pipeline.init_state(seats))
        self._sessions: dict[int, SessionCore] = {}  # by seat, the session that was stepped last at the end
        self._claimed: dict[int, float] = {}  # seats that a thread works on, and since when
        self.seats = seats  # how many sessions there can be
        self._look_ahead, self._rewind = look_ahead, self.chunk.within(REWIND_S) if rewind is None else rewind
        own_workers = threads() if pipeline.device == "cpu" else 0
        self._workers = own_workers if workers is None else workers
        self.is_batched = self._workers == 0  # sessions are stepped together, and one more in a step costs hardly more
        self.workers = max(1, self._workers)  # threads that can make use of `work`
        self._capacity = Capacity(self.workers, self.chunk.seconds)
        self._pool = ThreadPoolExecutor(self._workers, "worker") if self._workers > 1 else None
        self._beside = ThreadPoolExecutor(1, "face")  # its tasks wait for nobody, so threads may wait for them
        self._lock, self._awake = threading.RLock(), threading.Condition()

    @property
    def skeleton(self) -> Skeleton:
        """The rig of all sessions."""
        return self.pipeline.skeleton

    @property
    def room(self) -> int:
        """How many live sessions the machine carries now, at most the seats."""
        with self._lock:
            return self._capacity.room(self.seats)

    @property
    def free(self) -> int:
        """How many more live sessions can be opened now; negative where there are more than the machine carries."""
        return self.room - len(self._sessions)

    def measure(self) -> None:
        """Find out how many sessions the machine carries; for servers, before the first one comes.

        Otherwise a crowd that comes at once would be let in before the cost of a chunk is known.
        """
        sessions = [self.open() for _ in range(min(self.workers, self.seats))]
        for session in sessions:
            session.push(np.zeros(MEASURED * self.chunk.samples, np.float32))
        self.tick()  # the first one takes longer
        self._capacity.forget()
        while self.tick():
            pass
        for session in sessions:
            session.close()

    def open(self, *, seed: int = 0, options: MotionOptions = FREE) -> Session:
        """Open a session. Its motion depends on its seed, `options` and audio alone, not on its neighbours.

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
        """As `open`, for servers: see `SessionCore`. A paced session is a live one."""
        with self._lock:
            free = [seat for seat in range(self.seats) if seat not in self._sessions]
            if not free:
                raise AdmissionError(
                    f"all {self.seats} seats are taken; close a session or open the engine with more seats"
                )
            if is_paced and self.free < 1:
                raise AdmissionError(f"this machine carries {self.room} sessions now; close one, or try again later")
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
        ready = self._claim(everyone=True)
        size = max(1, self._share(len(ready)))
        groups = [ready[first : first + size] for first in range(0, len(ready), size)]
        make = partial(self._make, beside=self._beside if len(groups) < self._workers else None)
        list((self._pool.map if self._pool else map)(lambda group: self._step(group, make), groups))
        for session in ready:
            if session.error is not None:
                raise session.error
        return len(ready)

    def work(self) -> bool:
        """Step a worker's share of the sessions that are ready as one batch; False if none is."""
        ready = self._claim(everyone=self.is_batched)
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
        rows = Rows(pipeline.init_state(self.seats))
        try:
            for new, old in zip(rows.state.arrays(), self._rows.state.arrays(), strict=True):
                new[:] = old
        except Exception as error:
            _LOG.exception("the states of the sessions are lost")
            for session in list(self._sessions.values()):
                session.fail(error)
        with self._lock:
            self.pipeline, self._rows, self.fault = pipeline, rows, None
            self.restarts += 1
        self.wake()

    def _share(self, ready: int) -> int:
        """How many of `ready` sessions go into one worker's batch."""
        most = self.seats if self.is_batched or self.pipeline.rows_are_apart else 1
        return min(most, math.ceil(ready / self.workers))

    def _claim(self, *, everyone: bool) -> list[SessionCore]:
        """Claim sessions that are ready and that no thread works on, those with the least motion ahead first.

        Without `everyone`, only a worker's share of those with the least motion ahead: the others do not delay them.
        """
        with self._lock:
            if self.fault is not None:
                return []
            idle = [session for seat, session in self._sessions.items() if seat not in self._claimed]
            ready = sorted(((each.ahead, each) for each in idle if each.is_ready), key=itemgetter(0))
            if not everyone:
                ready = [(ahead, each) for ahead, each in ready if ahead <= max(0, ready[0][0])]
                ready = ready[: self._share(len(ready))]
            claimed = [session for _, session in ready]
            for session in claimed:
                self._claimed[session.seat] = time.monotonic()
                self._sessions[session.seat] = self._sessions.pop(session.seat)  # last among equals next time
        return claimed

    def _step(self, ready: list[SessionCore], make: Callable[[list[SessionCore]], None]) -> None:
        """Make the next chunk of these sessions, as one batch."""
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
                self._capacity.note(self.step_seconds, self.seats if self.is_batched else len(ready))
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

    def _make(self, ready: list[SessionCore], beside: Executor | None = None) -> None:
        """Make a chunk of each session; a fault leaves their rows as they were. `beside` makes the faces."""
        seats = list(range(self.seats)) if self.is_batched else [session.seat for session in ready]
        rows = [seats.index(session.seat) for session in ready]
        count = len(seats)
        audio, active = np.zeros((count, self.chunk.samples), np.float32), np.zeros(count, np.bool_)
        members, is_asked, forgets = np.zeros((count, self._codes), np.float32), False, np.zeros(count, np.bool_)
        manner, hands = np.full((count, len(TOLD)), np.nan, np.float32), np.tile(WHOLE, (count, 1))
        for row, session in zip(rows, ready, strict=True):
            if session.is_new:
                own, this = self._rows.of([session.seat]), np.ones(1, np.bool_)
                self.pipeline.reset(own, this, seed=session.seed, options=session.options)
                session.is_new = False
            plan = session.begin_chunk(self._codes)
            for patch in plan.undone:  # undoing again, after a fault, changes nothing more
                self._rows.undo(session.seat, patch)
            audio[row], active[row], forgets[row] = plan.audio, True, plan.forgets
            manner[row], hands[row] = plan.manner, plan.hands
            if plan.members is not None:
                members[row], is_asked = plan.members, True
        before, state = [self._rows.kept(session.seat) for session in ready], self._rows.of(seats)
        told: dict[str, Any] = {"directive": self.pipeline.directive(members)} if is_asked else {}
        told |= {"manner": manner, "hands": hands} if self.pipeline.has_manner else {}
        told |= {"beside": beside} if beside else {}
        try:
            if forgets.any():
                self.pipeline.restart_generator(state, forgets)
            chunks = self.pipeline.step(audio, state, active, **told)
            self._rows.put(seats, state)
            undoing = [self._rows.changes(session.seat, patch) for session, patch in zip(ready, before, strict=True)]
        except BaseException:
            for session, patch in zip(ready, before, strict=True):
                self._rows.undo(session.seat, patch)
            raise
        for row, session, patch in zip(rows, ready, undoing, strict=True):
            with suppress(Exception):  # the session notes it as its error
                session.end_chunk(chunks[row], patch)


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

    `without` names stages to leave out, see `Bundle.without`; `runtime` says which additions run, see `Runtime.chosen`.

    Raises:
        CheckpointError: the bundle is missing or damaged.
        EchoAvatarError: the device or a stage does not exist.
    """

    def build() -> Pipeline:
        pipeline = Pipeline(load_bundle(bundle).running(runtime).without(without), precision=precision, device=device)
        pipeline.warm_up()
        return pipeline

    pipeline = build()
    for part in (homecoming, idle_motion, gaze):
        part.warm_up(pipeline.skeleton)
    feeling.warm_up()
    give_back()  # 190 MB are free now
    return Engine(pipeline, seats=seats, look_ahead=look_ahead, reload=build)


def give_back() -> None:
    """Give free whole pages back to the system, in some milliseconds. Only glibc needs this, and only it can do so.

    A session holds some 20 MB. glibc keeps freed blocks between blocks in use, so a server whose sessions come and go
    grows by a hundred megabytes, though no more is in use than at its start.
    """
    with suppress(AttributeError, OSError, TypeError):  # another C library; Windows has no library without a name
        ctypes.CDLL(None).malloc_trim(0)
