"""`echoavatar bench sessions`: how many sessions keep up, and how long their chunks wait.

Sessions arrive at odd moments, each sends a chunk of sound as often as one lasts by the wall clock, and one engine
serves them from its own threads, as in the server. So a run takes as long as its sound, and other programs on the
machine show.
"""

import gc
import threading
import time
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
import torch

from ..engine import Engine, EngineThread, SessionCore
from ..pipeline import Pipeline
from .stream_bench import resident_mb

Manner = Literal["behaves", "floods", "stalls", "vanishes"]
MANNERS: tuple[Manner, ...] = ("behaves", "floods", "stalls", "vanishes")
WARM_UP_CHUNKS = 16  # longer than the attention window
GOLDEN = 0.6180339887  # phases of the sessions: spread as evenly as they can be for any number
HOPELESS = 4  # chunks: a load that waits so long is not made heavier


class Load(NamedTuple):
    """One number of sessions, and how they fared."""

    sessions: int
    p50_ms: float  # from a chunk's sound being complete to its motion being there
    p99_ms: float
    busy: float  # share of the workers' time that they worked
    memory_mb: float  # of each session, rewind included
    in_real_time: bool  # p99 within a chunk, and not falling behind


def bench_sessions(
    pipeline: Pipeline,
    counts: tuple[int, ...] = (1, 2, 3, 4),
    *,
    seconds: float = 20.0,
    progress: Callable[[int, int], None] | None = None,
) -> list[Load]:
    """Serve every number of sessions for so long; stops early where one cannot be served at all."""
    loads: list[Load] = []
    for done, count in enumerate(counts):
        loads.append(_serve(pipeline, count, seconds))
        if progress:
            progress(done + 1, len(counts))
        if loads[-1].p99_ms > 1000 * HOPELESS * pipeline.chunk.seconds:
            break
    return loads


def bench_neighbour(pipeline: Pipeline, *, sessions: int = 2, seconds: float = 20.0) -> dict[str, float]:
    """p99 of well-behaved sessions, in ms, beside one that behaves, floods, stalls or vanishes."""
    return {manner: _serve(pipeline, sessions + 1, seconds, manner).p99_ms for manner in MANNERS}


def summary(loads: list[Load]) -> dict[str, object]:
    """One line for machines."""
    served = [load.sessions for load in loads if load.in_real_time]
    return {
        "sessions_in_real_time": max(served, default=0),
        "threads": torch.get_num_threads(),
        "loads": [load._asdict() for load in loads],
    }


def _serve(pipeline: Pipeline, count: int, seconds: float, last: Manner = "behaves") -> Load:
    gc.collect()  # what the load before left behind
    before, each = resident_mb(), pipeline.chunk.seconds
    engine = Engine(pipeline, seats=count, look_ahead=8)
    guests = [_Guest(engine.open_core(seed=seat), seat) for seat in range(count)]
    guests[-1].manner = last
    chunks = max(4, round(seconds / each)) + WARM_UP_CHUNKS
    with EngineThread(engine) as threads:
        began = time.perf_counter()
        due = [(began + guest.phase + chunk * each, guest) for guest in guests for chunk in range(chunks)]
        for moment, guest in sorted(due, key=lambda item: item[0]):
            time.sleep(max(0.0, moment - time.perf_counter()))
            guest.send(moment - began)
            if threads.error is not None:
                raise threads.error
        watched = [guest for guest in guests if guest.manner == "behaves"]
        patience = time.perf_counter() + HOPELESS * each * count
        while any(len(guest.waits) < chunks for guest in watched) and time.perf_counter() < patience:
            time.sleep(0.01)
        busy = engine.busy_seconds / (time.perf_counter() - began) / engine.workers
        memory = (resident_mb() - before) / count
    is_behind = any(len(guest.waits) < chunks for guest in watched)
    for guest in guests:
        guest.session.close()
        guest.give_up()
    waits = np.concatenate([guest.waits[WARM_UP_CHUNKS:] for guest in watched])
    p50, p99 = np.percentile(waits, [50, 99]) * 1000
    tail = np.mean([guest.waits[-4:] for guest in watched])
    return Load(
        count,
        round(float(p50), 1),
        round(float(p99), 1),
        round(busy, 3),
        round(memory, 2),
        bool(p99 <= 1000 * each and tail < each and not is_behind),
    )


class _Guest:
    """A session, when its sound was sent, and how long each chunk's motion took from there."""

    def __init__(self, session: SessionCore, seat: int) -> None:
        self.session, self.manner = session, MANNERS[0]
        self.phase = (seat * GOLDEN) % 1 * self.session.chunk.seconds
        self.waits: list[float] = []
        self._sent: list[float] = []
        self._rng, self._lock = np.random.default_rng(seat), threading.Lock()
        session.on_motion = self._came

    def send(self, now: float) -> None:
        """A chunk of sound, or what its manner does instead."""
        if self.manner == "floods":
            if self.session.seconds_waiting < 60:
                self.session.push(self._sound(20))
        elif self.manner == "vanishes" and now > 8 * self.session.chunk.seconds:
            self.session.close()
        elif self.manner != "stalls" or int(now / 2) % 2:
            with self._lock:
                self._sent.append(time.perf_counter())
            self.session.push(self._sound(1))

    def _came(self) -> None:
        now = time.perf_counter()
        with self._lock:
            while self.session.take() is not None:
                if self._sent:
                    self.waits.append(now - self._sent.pop(0))

    def give_up(self) -> None:
        """What was not answered has waited until now."""
        now = time.perf_counter()
        self.waits.extend(now - sent for sent in self._sent)

    def _sound(self, chunks: int) -> np.ndarray:
        return (0.1 * self._rng.standard_normal(chunks * self.session.chunk.samples)).astype(np.float32)
