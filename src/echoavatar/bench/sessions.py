"""`echoavatar bench sessions`: how many sessions one engine serves in real time, and how long their chunks wait.

Sessions start one after the other. Those that the engine has room for send audio in real time, chunk by chunk, and the
engine serves them from its own threads, as in the server; the others are refused. A run therefore takes as long as its
audio, and other load on the machine affects it.
"""

import gc
import threading
import time
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from echoavatar.engine import Engine, EngineThread, SessionCore
from echoavatar.engine.pipeline import Pipeline
from echoavatar.nn.device import threads

from .stream import resident_mb

ClientKind = Literal["behaves", "floods", "stalls", "vanishes"]
CLIENT_KINDS: tuple[ClientKind, ...] = ("behaves", "floods", "stalls", "vanishes")
WARM_UP_CHUNKS = 16  # longer than the attention window
GOLDEN_RATIO = 0.6180339887  # spreads the sessions' phases evenly for any number of them
GIVE_UP_CHUNKS = 4  # p99 of waiting, in chunks, beyond which larger loads are not tried
COUNTS = (1, 2, 4, 6, 8, 10, 12, 16)
JOIN_CHUNKS = 1  # between the starts of two sessions
LATE_MS = 150.0  # the server schedules silence this long before it is due, plus the engine's own time


class Load(NamedTuple):
    """A number of sessions that asked for a seat, and how those that were admitted were served."""

    sessions: int
    admitted: int
    p50_ms: float  # from the end of a chunk's audio to its motion
    p99_ms: float
    late: int  # chunks that took longer than `LATE_MS`
    busy: float  # share of time that the workers worked
    memory_mb: float  # for each session, including the rewind buffer
    in_real_time: bool  # p99 is within a chunk, and the delay does not grow


def bench_sessions(
    pipeline: Pipeline,
    counts: tuple[int, ...] = COUNTS,
    *,
    seconds: float = 20.0,
    progress: Callable[[int, int], None] | None = None,
) -> list[Load]:
    """Serve each number of sessions for `seconds`; stops at a number that is far from real time."""
    loads: list[Load] = []
    for done, count in enumerate(counts):
        loads.append(_serve(pipeline, count, seconds))
        if progress:
            progress(done + 1, len(counts))
        if loads[-1].p99_ms > 1000 * GIVE_UP_CHUNKS * pipeline.chunk.seconds:
            break
    return loads


def bench_neighbour(pipeline: Pipeline, *, sessions: int = 2, seconds: float = 20.0) -> dict[str, float]:
    """p99 in ms of well-behaved sessions beside one that behaves, floods, stalls or vanishes; none is refused."""
    return {kind: _serve(pipeline, sessions + 1, seconds, kind).p99_ms for kind in CLIENT_KINDS}


def summary(loads: list[Load]) -> dict[str, object]:
    """The report as one JSON object."""
    served = [load.admitted for load in loads if load.in_real_time]
    return {
        "admitted": max((load.admitted for load in loads), default=0),
        "sessions_in_real_time": max(served, default=0),
        "threads": threads(),
        "loads": [load._asdict() for load in loads],
    }


def _serve(pipeline: Pipeline, count: int, seconds: float, last: ClientKind | None = None) -> Load:
    """Measure `count` sessions. With `last`, all are admitted, and the last one is of that kind."""
    gc.collect()  # memory of the previous load
    before, chunk_s = resident_mb(), pipeline.chunk.seconds
    engine = Engine(pipeline, seats=count, look_ahead=8)
    engine.measure()
    chunks = max(4, round(seconds / chunk_s)) + WARM_UP_CHUNKS
    admitted: dict[int, _Client] = {}
    with EngineThread(engine) as threads:
        began, worked = time.perf_counter(), engine.busy_seconds
        starts = [(JOIN_CHUNKS * seat + (seat * GOLDEN_RATIO) % 1) * chunk_s for seat in range(count)]
        due = [(began + start + chunk * chunk_s, seat) for seat, start in enumerate(starts) for chunk in range(chunks)]
        for moment, seat in sorted(due):
            time.sleep(max(0.0, moment - time.perf_counter()))
            is_first = moment == began + starts[seat]
            if is_first and (engine.free > 0 or last):
                kind = last if last and seat == count - 1 else "behaves"
                admitted[seat] = _Client(engine.open_core(seed=seat), seat, kind)
            if seat in admitted:
                admitted[seat].send(moment - began - starts[seat])
            if threads.error is not None:
                raise threads.error
        clients = list(admitted.values())
        watched = [client for client in clients if client.kind == "behaves"]
        deadline = time.perf_counter() + GIVE_UP_CHUNKS * chunk_s * count
        while any(len(client.waits) < chunks for client in watched) and time.perf_counter() < deadline:
            time.sleep(0.01)
        busy = (engine.busy_seconds - worked) / (time.perf_counter() - began) / engine.workers
        memory = (resident_mb() - before) / len(clients)
    is_behind = any(len(client.waits) < chunks for client in watched)
    for client in clients:
        client.session.close()
        now = time.perf_counter()
        client.waits.extend(now - sent for sent in client.unanswered)  # as if answered now
    waits = 1000 * np.concatenate([client.waits[WARM_UP_CHUNKS:] for client in watched])
    p50, p99 = np.percentile(waits, [50, 99])
    tail = np.mean([client.waits[-4:] for client in watched])
    return Load(
        sessions=count,
        admitted=len(clients),
        p50_ms=round(float(p50), 1),
        p99_ms=round(float(p99), 1),
        late=int((waits > LATE_MS).sum()),
        busy=round(busy, 3),
        memory_mb=round(memory, 2),
        in_real_time=bool(p99 <= 1000 * chunk_s and tail < chunk_s and not is_behind),
    )


class _Client:
    """A client session: sends audio on time and records how long the motion of each chunk took."""

    def __init__(self, session: SessionCore, seat: int, kind: ClientKind) -> None:
        self.session, self.kind = session, kind
        self.waits: list[float] = []
        self.unanswered: list[float] = []  # when each chunk without motion was sent
        self._rng, self._lock = np.random.default_rng(seat), threading.Lock()
        session.on_motion = self._on_motion

    def send(self, now: float) -> None:
        """Send a chunk of audio, or misbehave."""
        if self.kind == "floods":
            if self.session.seconds_waiting < 60:
                self.session.push(self._sound(20))
        elif self.kind == "vanishes" and now > 8 * self.session.chunk.seconds:
            self.session.close()
        elif self.kind != "stalls" or int(now / 2) % 2:
            with self._lock:
                self.unanswered.append(time.perf_counter())
            self.session.push(self._sound(1))

    def _on_motion(self) -> None:
        now = time.perf_counter()
        with self._lock:
            while self.session.take() is not None:
                if self.unanswered:
                    self.waits.append(now - self.unanswered.pop(0))

    def _sound(self, chunks: int) -> np.ndarray:
        return (0.1 * self._rng.standard_normal(chunks * self.session.chunk.samples)).astype(np.float32)
