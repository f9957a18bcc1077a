"""`echoavatar bench stream`: the cost of one session by stage (paper, Table Real-time Performance Evaluation).

Times are wall times of one process; on a GPU a stage ends when its work is done there. The audio is noise bursts and
tones, because cost does not depend on content.
"""

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline
from echoavatar.engine.pipeline.pipeline import STAGES
from echoavatar.nn.device import threads
from echoavatar.nn.torch_backend import torch_backend
from echoavatar.timing import SAMPLE_RATE_HZ, ChunkSize

WARM_UP_CHUNKS = 20  # longer than the attention window, so that the ring buffer is full when timing starts
FULL_WARM_UP_CHUNKS = 2  # with an opening the window is full from the start
REPEAT_LIMIT_MS = 10_000  # a first motion that takes longer is measured only once


@dataclass
class StageTimer:
    """Milliseconds of each stage, chunk by chunk."""

    stages: dict[str, list[float]] = field(default_factory=lambda: {stage: [] for stage in STAGES})
    last: float = 0.0
    is_cuda: bool = False

    def start(self) -> None:
        """Start timing a chunk."""
        self.last = time.perf_counter()

    def __call__(self, stage: str) -> None:
        """Record the end of a stage."""
        if self.is_cuda:
            torch_backend("a GPU").synchronize()
        now = time.perf_counter()
        self.stages[stage].append((now - self.last) * 1000)
        self.last = now


@dataclass(frozen=True)
class StreamReport:
    """The measurements."""

    stages_ms: dict[str, tuple[float, float, float]]  # p50, p95, p99
    summary: dict[str, float]


def bench_stream(
    pipeline: Pipeline, *, seconds: float = 60.0, sessions: int = 1, progress: Callable[[int, int], None] | None = None
) -> StreamReport:
    """Push `seconds` of audio through `sessions` sessions at once and time every chunk."""
    pipeline.warm_up()
    first_ms = _first_motion_ms(pipeline)
    engine = Engine(pipeline, seats=sessions, workers=0)
    seats = [engine.open_core(seed=seat) for seat in range(sessions)]
    chunk, timer, chunk_ms, memory = pipeline.chunk, StageTimer(is_cuda=pipeline.device != "cpu"), [], []
    warm_up = FULL_WARM_UP_CHUNKS if pipeline.has_opening else WARM_UP_CHUNKS
    chunks = max(2, round(seconds / chunk.seconds)) + warm_up
    rng = np.random.default_rng(0)
    before, pipeline.on_stage = pipeline.on_stage, timer
    try:
        for index in range(chunks):
            for seat in seats:
                seat.push(_sound(rng, index, chunk))
            timer.start()
            began = time.perf_counter()
            engine.tick()
            chunk_ms.append((time.perf_counter() - began) * 1000)
            for seat in seats:
                seat.take()
            if index >= warm_up and (index - warm_up) % 50 == 0:
                memory.append(resident_mb())
            if progress:
                progress(index + 1, chunks)
    finally:
        pipeline.on_stage = before
    memory.append(resident_mb())
    for seat in seats:
        seat.close()
    counted = np.array(chunk_ms[warm_up:])
    rows = {stage: _percentiles(np.array(values[warm_up:])) for stage, values in timer.stages.items()}
    rows["whole chunk"] = _percentiles(counted)
    summary = {
        "rtf": float(counted.mean() / 1000 / chunk.seconds),
        **dict(zip(("chunk_ms_p50", "chunk_ms_p95", "chunk_ms_p99"), rows["whole chunk"], strict=True)),
        "first_motion_ms": first_ms,
        "rss_mb_start": memory[0],
        "rss_mb_end": memory[-1],
        "seconds": float(len(counted) * chunk.seconds),
        "sessions": float(sessions),
        "threads": float(threads()),
    }
    return StreamReport(rows, {key: round(value, 3) for key, value in summary.items()})


def _first_motion_ms(pipeline: Pipeline) -> float:
    """Milliseconds from a live source's first sample to the first frame: waiting for a chunk, then computing it."""
    times = []
    for attempt in range(3):
        with Engine(pipeline).open(seed=attempt) as session:
            session.push(_sound(np.random.default_rng(attempt), 0, pipeline.chunk))
            began = time.perf_counter()
            next(iter(session))
            times.append((time.perf_counter() - began) * 1000)
        if times[-1] > REPEAT_LIMIT_MS:
            break
    return pipeline.chunk.seconds * 1000 + float(np.median(times))


def _sound(rng: np.random.Generator, index: int, chunk: ChunkSize) -> np.ndarray:
    time_s = (np.arange(chunk.samples) + index * chunk.samples) / SAMPLE_RATE_HZ
    tone = 0.1 * np.sin(2 * np.pi * 220 * time_s) * (index % 4 < 3)
    return (tone + 0.02 * rng.standard_normal(chunk.samples)).astype(np.float32)


def _percentiles(values: np.ndarray) -> tuple[float, float, float]:
    p50, p95, p99 = np.percentile(values, [50, 95, 99])
    return float(p50), float(p95), float(p99)


def resident_mb() -> float:
    """Resident memory of this process in MB; the peak where only that is known (macOS), 0 on Windows."""
    status = Path("/proc/self/statm")
    if status.exists():
        return int(status.read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    try:
        import resource
    except ModuleNotFoundError:  # Windows
        return 0.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
