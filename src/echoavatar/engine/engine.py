"""Many sessions, one batch: each session owns one row of the pipeline's state, and nothing happens except in `tick`."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch

from ..errors import AdmissionError, EchoAvatarError
from ..generator.linear import Precision
from ..pipeline import ActionLibrary, Pipeline, load_bundle
from ..pipeline.modes import FREE, MotionOptions
from ..timing import CHUNK, ChunkSize
from .life import warm_up
from .session import Session
from .undo import changes, undo

REWIND = 15  # chunks, 4 s at the paper's step: how far `Session.clear` can go back


class Engine:
    """A pure machine: one thread calls `tick` (tests and scripts call it directly); sessions may live in others."""

    def __init__(
        self,
        pipeline: Pipeline,
        *,
        seats: int = 1,
        look_ahead: int | None = None,
        rewind: int = REWIND,
        lanes: int | None = None,
    ) -> None:
        """`look_ahead` bounds the chunks made ahead of the player (`Session.played`) or else of the reader; `rewind`
        is how many a session can take back, at 0.4 MB each with the default bundle.

        `lanes` sessions are stepped side by side, each by itself (default: as many as torch has threads; with more
        than one, torch computes each with one thread); 0 steps all seats as one batch. On a CPU the inner loops cost
        as much per row in a batch as alone, and a batch makes whoever is ready wait for seats that have nothing to
        do; on a GPU a batch costs hardly more than a row.
        """
        if seats < 1:
            raise EchoAvatarError(f"an engine needs at least one seat, got {seats}")
        if look_ahead is not None and look_ahead < 1:
            raise EchoAvatarError(f"look_ahead must be at least one chunk, got {look_ahead}")
        self.pipeline = pipeline
        self.chunk: ChunkSize = getattr(pipeline, "chunk", CHUNK)  # what a step of every session takes
        self.actions: ActionLibrary = getattr(pipeline, "actions", ActionLibrary())
        self.ticks, self.tick_seconds = 0, 0.0  # how many ticks had work, and how long the last of them took
        self._codes: int = getattr(pipeline, "directive_codes", 0)
        self._state = pipeline.init_state(seats)
        self._sessions: dict[int, Session] = {}
        self._new: list[Session] = []
        self._seats, self._look_ahead, self._rewind = seats, look_ahead, rewind
        self._lanes = torch.get_num_threads() if lanes is None else lanes
        self._pool = ThreadPoolExecutor(self._lanes, "lane", _in_one_thread) if self._lanes > 1 else None
        self._lock, self._awake = threading.RLock(), threading.Event()

    @property
    def seats(self) -> int:
        """How many sessions there can be."""
        return self._seats

    @property
    def free(self) -> int:
        """How many more sessions can be opened now."""
        return self._seats - len(self._sessions)

    def open(self, *, seed: int = 0, options: MotionOptions = FREE) -> Session:
        """Seat a new session; the same seed and audio give the same motion, whoever sits beside it.

        `options` keep it in place, on a leash, or standing from the hips down.

        Raises:
            AdmissionError: all seats are taken.
        """
        with self._lock:
            free = [seat for seat in range(self._seats) if seat not in self._sessions]
            if not free:
                raise AdmissionError(
                    f"all {self._seats} seats are taken; close a session or open the engine with more seats"
                )
            session = Session(
                self, free[0], seed=seed, options=options, look_ahead=self._look_ahead, rewind=self._rewind
            )
            self._sessions[free[0]] = session
            self._new.append(session)
            return session

    def release(self, session: Session) -> None:
        """Free a session's seat; `Session.close` calls this."""
        with self._lock:
            if self._sessions.get(session.seat) is session:
                del self._sessions[session.seat]

    def wake(self) -> None:
        """There may be work; sessions call this."""
        self._awake.set()

    def wait(self, seconds: float) -> None:
        """Sleep until there may be work, for so long at most."""
        self._awake.wait(seconds)
        self._awake.clear()

    @torch.inference_mode()
    def tick(self) -> int:
        """Step every session that has a chunk waiting; return how many moved."""
        began = time.perf_counter()
        seated = self._settle()
        ready = [session for session in seated if session.waiting]
        if not ready:
            return 0
        groups = [[session] for session in ready] if self._lanes else [ready]
        list((self._pool.map if self._pool else map)(self._step, groups))
        self.ticks, self.tick_seconds = self.ticks + 1, time.perf_counter() - began
        return len(ready)

    def _settle(self) -> list[Session]:
        """Rows of new sessions are reset, rows of sessions that go back are put back; who is seated."""
        with self._lock:
            seated, new, self._new = list(self._sessions.values()), self._new, []
        for session in new:
            rows = torch.zeros(self._seats, dtype=torch.bool)
            rows[session.seat] = True
            self.pipeline.reset(self._state, rows, seed=session.seed, options=session.options)
        for session in seated:
            for patches in session.unmake():
                undo(patches, self._state, session.seat)
        return seated

    @torch.inference_mode()
    def _step(self, ready: list[Session]) -> None:
        """The next chunk of one session; or of several, in one batch of all seats."""
        seats = slice(0, self._seats) if len(ready) > 1 else slice(ready[0].seat, ready[0].seat + 1)
        rows = seats.stop - seats.start
        audio, active = np.zeros((rows, self.chunk.samples), np.float32), torch.zeros(rows, dtype=torch.bool)
        members, is_asked, forgets = torch.zeros(rows, self._codes), False, torch.zeros_like(active)
        for session in ready:
            row = session.seat - seats.start
            begun = session.begin_chunk(self._codes)
            audio[row], active[row], forgets[row] = begun.audio, True, begun.forgets
            if begun.members is not None:
                members[row], is_asked = begun.members, True
        state = self._state.rows(seats)
        before = state.snapshot() if self._rewind else []
        if forgets.any():
            self.pipeline.forget(state, forgets)
        directive = {"directive": self.pipeline.directive(members)} if is_asked else {}
        chunks = self.pipeline.step(torch.from_numpy(audio), state, active, **directive)
        for session in ready:
            row = session.seat - seats.start
            session.end_chunk(chunks[row], changes(before, state, row) if self._rewind else [])


def _in_one_thread() -> None:
    torch.set_num_threads(1)


def load(
    bundle: str | Path = "default",
    *,
    seats: int = 1,
    precision: Precision = "int8",
    look_ahead: int | None = None,
) -> Engine:
    """An engine for a bundle: the name of a shipped one, or a folder.

    Raises:
        CheckpointError: no such bundle, or a damaged one.
    """
    pipeline = Pipeline(load_bundle(bundle), precision=precision)
    warm_up(pipeline.skeleton)
    pipeline.warm_up()
    return Engine(pipeline, seats=seats, look_ahead=look_ahead)
