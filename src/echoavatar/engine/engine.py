"""Many sessions over one pipeline: each owns one row of its state. Chunks are made in `tick` and `work` only.

A worker claims a session's seat before it steps it, so several threads may call either at once.
"""

import threading
import time
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch

from echoavatar.errors import AdmissionError, EchoAvatarError
from echoavatar.models.generator.linear import Precision
from echoavatar.motion.idle_motion import warm_up
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.timing import CHUNK, ChunkSize

from .audio_queue import QUEUE_SECONDS
from .pipeline import ActionLibrary, Pipeline, load_bundle
from .session import Session
from .session_core import SessionCore
from .undo import changes, undo

_HOST = torch.device("cpu")
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
    ) -> None:
        """`look_ahead` bounds the chunks made ahead of the player, or of the reader if the player does not report.

        `rewind` is how many chunks a session can take back; each costs 0.4 MB with the default bundle.

        `workers` threads step sessions side by side, each session by itself (default: as many as torch has threads, or
        0 if the models are on a GPU; with more than one, torch computes each session in one thread). 0 steps all
        sessions as one batch. A CPU spends as much on a row of a batch as on a row alone, and a batch would make a
        session that is ready wait for the others; a GPU spends hardly more on a batch than on a row.
        """
        if seats < 1:
            raise EchoAvatarError(f"an engine needs at least one seat, got {seats}")
        if look_ahead is not None and look_ahead < 1:
            raise EchoAvatarError(f"look_ahead must be at least one chunk, got {look_ahead}")
        self.pipeline = pipeline
        self.chunk: ChunkSize = getattr(pipeline, "chunk", CHUNK)  # what a step of every session takes
        self.actions: ActionLibrary = getattr(pipeline, "actions", ActionLibrary())
        self.step_seconds = 0.0  # duration of the last step
        self.busy_seconds = 0.0  # duration of all steps
        self._codes: int = getattr(pipeline, "directive_codes", 0)
        self._state = pipeline.init_state(seats)
        self._sessions: dict[int, SessionCore] = {}  # by seat, the session that was stepped last at the end
        self._claimed: set[int] = set()  # seats that a thread works on
        self._seats, self._look_ahead, self._rewind = seats, look_ahead, rewind
        is_on_host = getattr(pipeline, "device", _HOST).type == _HOST.type
        self._workers = (torch.get_num_threads() if is_on_host else 0) if workers is None else workers
        self._pool = ThreadPoolExecutor(self._workers, "worker", _in_one_thread) if self._workers > 1 else None
        self._lock, self._awake = threading.RLock(), threading.Event()

    @property
    def skeleton(self) -> Skeleton:
        """The rig of all sessions."""
        return self.pipeline.skeleton

    @property
    def seats(self) -> int:
        """How many sessions there can be."""
        return self._seats

    @property
    def free(self) -> int:
        """How many more sessions can be opened now."""
        return self._seats - len(self._sessions)

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
            free = [seat for seat in range(self._seats) if seat not in self._sessions]
            if not free:
                raise AdmissionError(
                    f"all {self._seats} seats are taken; close a session or open the engine with more seats"
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
        self._awake.set()

    def wait(self, seconds: float) -> None:
        """Sleep until a chunk may be due, for so long at most."""
        self._awake.wait(seconds)
        self._awake.clear()

    @property
    def workers(self) -> int:
        """How many threads can make use of `work`."""
        return max(1, self._workers)

    def tick(self) -> int:
        """Step every session that is ready; return how many were."""
        ready = self._claim(self._seats)
        groups = [[session] for session in ready] if self._workers else [ready] if ready else []
        list((self._pool.map if self._pool else map)(self._step, groups))
        return len(ready)

    def work(self) -> bool:
        """Step the session with the least motion ahead, or all that are ready as one batch; False if none is."""
        ready = self._claim(1 if self._workers else self._seats)
        if ready:
            self._step(ready)
        return bool(ready)

    def _claim(self, most: int) -> list[SessionCore]:
        """Claim sessions that are ready and that no thread works on, those with the least motion ahead first."""
        with self._lock:
            idle = [session for seat, session in self._sessions.items() if seat not in self._claimed]
            ready = sorted((session for session in idle if session.is_ready), key=lambda session: session.ahead)[:most]
            for session in ready:
                self._claimed.add(session.seat)
                self._sessions[session.seat] = self._sessions.pop(session.seat)  # last among equals next time
        return ready

    @torch.inference_mode()
    def _step(self, ready: list[SessionCore]) -> None:
        """The next chunk of one session; or of several, in one batch of all seats."""
        began = time.perf_counter()
        try:
            for session in ready:
                self._open_row(session)
            self._make(ready)
        finally:
            with self._lock:
                self._claimed.difference_update(session.seat for session in ready)
                self.step_seconds = time.perf_counter() - began
                self.busy_seconds += self.step_seconds

    def _open_row(self, session: SessionCore) -> None:
        """Reset the row of a new session."""
        if session.is_new:
            row = self._state.rows(slice(session.seat, session.seat + 1))
            active = torch.ones(1, dtype=torch.bool)
            self.pipeline.reset(row, active, seed=session.seed, options=session.options)
            session.is_new = False

    def _make(self, ready: list[SessionCore]) -> None:
        seats = slice(0, self._seats) if len(ready) > 1 else slice(ready[0].seat, ready[0].seat + 1)
        rows = seats.stop - seats.start
        audio, active = np.zeros((rows, self.chunk.samples), np.float32), torch.zeros(rows, dtype=torch.bool)
        members, is_asked, forgets = torch.zeros(rows, self._codes), False, torch.zeros_like(active)
        for session in ready:
            row = session.seat - seats.start
            plan = session.begin_chunk(self._codes)
            for patches in plan.undone:
                undo(patches, self._state, session.seat)
            audio[row], active[row], forgets[row] = plan.audio, True, plan.forgets
            if plan.members is not None:
                members[row], is_asked = plan.members, True
        state = self._state.rows(seats)
        before = state.snapshot() if self._rewind else []
        if forgets.any():
            self.pipeline.restart_generator(state, forgets)
        directive = {"directive": self.pipeline.directive(members)} if is_asked else {}
        chunks = self.pipeline.step(torch.from_numpy(audio), state, active, **directive)
        for session in ready:
            row = session.seat - seats.start
            session.end_chunk(chunks[row], changes(before, state, row) if self._rewind else [])


def _in_one_thread() -> None:
    """Torch's thread count is a setting of each thread: one for a worker, unchanged elsewhere."""
    torch.set_num_threads(1)


def load(
    bundle: str | Path = "default",
    *,
    seats: int = 1,
    precision: Precision | None = None,
    look_ahead: int | None = None,
    device: str = "cpu",
    without: Collection[str] = (),
) -> Engine:
    """An engine for a bundle: the name of a shipped one, or a folder. For `device` and `precision` see `Pipeline`.

    `without` names stages to leave out, see `Bundle.without`.

    Raises:
        CheckpointError: the bundle is missing or damaged.
        EchoAvatarError: the device or a stage does not exist.
    """
    pipeline = Pipeline(load_bundle(bundle).without(without), precision=precision, device=device)
    warm_up(pipeline.skeleton)
    pipeline.warm_up()
    return Engine(pipeline, seats=seats, look_ahead=look_ahead)
