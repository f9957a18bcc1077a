"""Many sessions: each owns one row of the pipeline's state, and nothing happens except in `tick` and `work`.

Whoever steps a session claims its seat first, so several threads may call either at once.
"""

import threading
import time
from collections.abc import Collection
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

_HOST = torch.device("cpu")
REWIND = 15  # chunks, 4 s at the paper's step: how far `Session.clear` can go back


class Engine:
    """A pure machine: `EngineThread` calls `work`, scripts call `tick`; sessions may live in other threads."""

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

        `lanes` sessions are stepped side by side, each by itself (default: as many as torch has threads, 0 where the
        models are on a GPU; with more than one, torch computes each with one thread), and a lane that is free takes
        the next one at once; 0 steps all seats as one batch. On a CPU the inner loops cost as much per row in a batch
        as alone, and a batch makes whoever is ready wait for seats that have nothing to do; on a GPU a batch costs
        hardly more than a row.
        """
        if seats < 1:
            raise EchoAvatarError(f"an engine needs at least one seat, got {seats}")
        if look_ahead is not None and look_ahead < 1:
            raise EchoAvatarError(f"look_ahead must be at least one chunk, got {look_ahead}")
        self.pipeline = pipeline
        self.chunk: ChunkSize = getattr(pipeline, "chunk", CHUNK)  # what a step of every session takes
        self.actions: ActionLibrary = getattr(pipeline, "actions", ActionLibrary())
        self.step_seconds = 0.0  # how long the last step took
        self.busy_seconds = 0.0  # all steps together
        self._codes: int = getattr(pipeline, "directive_codes", 0)
        self._state = pipeline.init_state(seats)
        self._sessions: dict[int, Session] = {}
        self._claimed: set[int] = set()  # seats that a thread works on
        self._seats, self._look_ahead, self._rewind = seats, look_ahead, rewind
        is_on_host = getattr(pipeline, "device", _HOST).type == _HOST.type
        self._lanes = (torch.get_num_threads() if is_on_host else 0) if lanes is None else lanes
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

    @property
    def lanes(self) -> int:
        """How many threads are of use to `work`."""
        return max(1, self._lanes)

    def tick(self) -> int:
        """Step every session that has a chunk waiting; return how many moved."""
        ready = self._claim(self._seats)
        groups = [[session] for session in ready] if self._lanes else [ready] if ready else []
        list((self._pool.map if self._pool else map)(self._step, groups))
        return len(ready)

    def work(self) -> bool:
        """Step the session that is the shortest of motion (all that wait, where a batch is one step); False if none."""
        ready = self._claim(1 if self._lanes else self._seats)
        if ready:
            self._step(ready)
        return bool(ready)

    def _claim(self, most: int) -> list[Session]:
        """Sessions with a chunk waiting whose seats nobody works on, now ours."""
        with self._lock:
            idle = [session for seat, session in self._sessions.items() if seat not in self._claimed]
            ready = sorted(
                (session for session in idle if session.waiting), key=lambda session: session.ahead
            )[:most]
            for session in ready:
                self._claimed.add(session.seat)
                self._sessions[session.seat] = self._sessions.pop(
                    session.seat
                )  # among equals the last in line
        return ready

    @torch.inference_mode()
    def _step(self, ready: list[Session]) -> None:
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

    def _open_row(self, session: Session) -> None:
        """Its row is reset if it is new."""
        if session.is_new:
            row = self._state.rows(slice(session.seat, session.seat + 1))
            everyone = torch.ones(1, dtype=torch.bool)
            self.pipeline.reset(row, everyone, seed=session.seed, options=session.options)
            session.is_new = False

    def _make(self, ready: list[Session]) -> None:
        seats = slice(0, self._seats) if len(ready) > 1 else slice(ready[0].seat, ready[0].seat + 1)
        rows = seats.stop - seats.start
        audio, active = np.zeros((rows, self.chunk.samples), np.float32), torch.zeros(rows, dtype=torch.bool)
        members, is_asked, forgets = torch.zeros(rows, self._codes), False, torch.zeros_like(active)
        for session in ready:
            row = session.seat - seats.start
            begun = session.begin_chunk(self._codes)
            for patches in begun.undone:
                undo(patches, self._state, session.seat)
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
    """A lane's own thread count; others keep theirs."""
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
    """An engine for a bundle, the name of a shipped one or a folder; for `device` and `precision` see `Pipeline`.

    `without` names stages to leave out, see `Bundle.without`.

    Raises:
        CheckpointError: no such bundle, or a damaged one.
        EchoAvatarError: there is no such device, or no such stage.
    """
    pipeline = Pipeline(load_bundle(bundle).without(without), precision=precision, device=device)
    warm_up(pipeline.skeleton)
    pipeline.warm_up()
    return Engine(pipeline, seats=seats, look_ahead=look_ahead)
