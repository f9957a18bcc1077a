"""`echoavatar bench sessions`: how many sessions keep up, and how long their chunks wait.

Sessions arrive at odd moments, each sends a chunk of sound as often as one lasts, and one engine serves them. Time is
simulated, work is not: the clock jumps to the next arrival where the engine would wait, and by the measured time of
every tick. So the bench takes as long as its work, and queueing shows as it would in a server.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch

from ..engine import Engine, Session
from ..pipeline import Pipeline
from .stream_bench import resident_mb

Clock = Callable[[], float]
WARM_UP_CHUNKS = 16  # longer than the attention window
GOLDEN = 0.6180339887  # phases of the sessions: spread as evenly as they can be for any number


class Load(NamedTuple):
    """One number of sessions, and how they fared."""

    sessions: int
    p50_ms: float  # from a chunk's sound being complete to its motion being there
    p99_ms: float
    busy: float  # share of the time that the engine worked
    memory_mb: float  # of each session, rewind included
    in_real_time: bool  # p99 within a chunk, and not falling behind


def bench_sessions(
    pipeline: Pipeline,
    counts: tuple[int, ...] = (1, 2, 3, 4),
    *,
    seconds: float = 20.0,
    clock: Clock = time.perf_counter,
    progress: Callable[[int, int], None] | None = None,
) -> list[Load]:
    """Serve every number of sessions for so long; stops early where one cannot be served at all."""
    loads: list[Load] = []
    for done, count in enumerate(counts):
        loads.append(_serve(pipeline, count, seconds, clock))
        if progress:
            progress(done + 1, len(counts))
        if loads[-1].p99_ms > 4000 * pipeline.chunk.seconds:
            break
    return loads


def bench_neighbour(
    pipeline: Pipeline, *, sessions: int = 2, seconds: float = 20.0, clock: Clock = time.perf_counter
) -> dict[str, float]:
    """p99 of well-behaved sessions, in ms, beside one that behaves, floods, stalls or vanishes."""
    manners = ("behaves", "floods", "stalls", "vanishes")
    return {manner: _serve(pipeline, sessions + 1, seconds, clock, manner).p99_ms for manner in manners}


def summary(loads: list[Load]) -> dict[str, object]:
    """One line for machines."""
    served = [load.sessions for load in loads if load.in_real_time]
    return {
        "sessions_in_real_time": max(served, default=0),
        "threads": torch.get_num_threads(),
        "loads": [load._asdict() for load in loads],
    }


def _serve(pipeline: Pipeline, count: int, seconds: float, clock: Clock, last: str = "behaves") -> Load:
    before = resident_mb()
    engine = Engine(pipeline, seats=count, look_ahead=8)
    visit = _Visit(engine, [engine.open(seed=seat) for seat in range(count)], clock, last)
    chunks = max(4, round(seconds / pipeline.chunk.seconds)) + WARM_UP_CHUNKS
    visit.run(chunks)
    memory = (resident_mb() - before) / count
    for session in visit.sessions:
        session.close()
    waits = np.array(visit.waits[: max(1, count - (last != "behaves"))]).flatten()
    p50, p99 = np.percentile(waits, [50, 99]) * 1000
    tail = np.mean([wait[-4:] for wait in visit.waits[: max(1, count - (last != "behaves"))]])
    busy = visit.worked / visit.counted
    return Load(
        count,
        round(float(p50), 1),
        round(float(p99), 1),
        round(busy, 3),
        round(memory, 2),
        bool(p99 <= 1000 * pipeline.chunk.seconds and tail < pipeline.chunk.seconds),
    )


class _Visit:
    """Sessions with their arrivals, and the clock that jumps."""

    def __init__(self, engine: Engine, sessions: list[Session], clock: Clock, last: str) -> None:
        self.engine, self.sessions, self._clock, self._last = engine, sessions, clock, last
        self.waits: list[list[float]] = [[] for _ in sessions]
        self.worked = self.counted = 0.0
        self._due = [(seat * GOLDEN) % 1 * self.engine.chunk.seconds for seat in range(len(sessions))]
        self._arrived: list[list[float]] = [[] for _ in sessions]
        self._rng = np.random.default_rng(0)

    def run(self, chunks: int) -> None:
        """Until every session that behaves has been served so many chunks."""
        now, begun = 0.0, 0.0
        watched = range(len(self.sessions) - (self._last != "behaves"))
        while min(len(self.waits[seat]) for seat in watched) < chunks:
            self._arrive(now)
            started = self._clock()
            moved = self.engine.tick()
            took = self._clock() - started
            if not moved:
                now = min(due for due in self._due if due > now)
                continue
            now += took
            self._deliver(now)
            if min(len(self.waits[seat]) for seat in watched) <= WARM_UP_CHUNKS:
                begun, self.worked = now, 0.0
            else:
                self.worked += took
        self.counted = max(now - begun, 1e-9)
        self.waits = [wait[WARM_UP_CHUNKS:chunks] for wait in self.waits]

    def _arrive(self, now: float) -> None:
        for seat, session in enumerate(self.sessions):
            while self._due[seat] <= now:
                due = self._due[seat]
                self._due[seat] += self.engine.chunk.seconds
                if seat == len(self.sessions) - 1 and self._misbehaves(session, due):
                    continue
                session.push(self._sound(1))
                self._arrived[seat].append(due)

    def _misbehaves(self, session: Session, due: float) -> bool:
        """What the last session does instead of sending a chunk."""
        if self._last == "floods":
            if session.seconds_waiting < 60:
                session.push(self._sound(20))
            return True
        if self._last == "vanishes" and due > 8 * self.engine.chunk.seconds:
            session.close()
            return True
        return self._last == "stalls" and int(due / 2) % 2 == 0

    def _deliver(self, now: float) -> None:
        for seat, session in enumerate(self.sessions):
            while session.take() is not None:
                if self._arrived[seat]:
                    self.waits[seat].append(now - self._arrived[seat].pop(0))

    def _sound(self, chunks: int) -> np.ndarray:
        return (0.1 * self._rng.standard_normal(chunks * self.engine.chunk.samples)).astype(np.float32)
