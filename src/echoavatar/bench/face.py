"""`echoavatar bench face`: the cost of a face, for one session and for a batch.

One session and the batch take turns, so that other processes slow both alike. Before every chunk as much memory is
touched as the other models of a session use (`evict_caches`). Processor times count all threads; wall times are what a
session waits for.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from echoavatar.models.face import FaceStream
from echoavatar.nn.device import threads
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME

WARM_UP = 3
_TURNS = 10  # chunks of one session to one of the batch
WEIGHTS = 15_000_000  # float32 values, 60 MB: about the weights of the default bundle


def bench_face(stream: FaceStream, *, chunks: int = 200, sessions: int = 64) -> dict[str, float]:
    """Milliseconds per step of `stream.config.step` frames: one session, a batch of `sessions`, and their ratio."""
    one, many = _chunks(stream, 1), _chunks(stream, sessions)
    for _ in range(WARM_UP):
        next(one), next(many)
    ones, batches = list[tuple[float, float]](), list[tuple[float, float]]()
    for _ in range(max(3, chunks // _TURNS)):
        ones += [next(one) for _ in range(_TURNS)]
        batches.append(next(many))
    alone, batch = np.array(ones), np.array(batches)
    alone_ms, batch_ms = np.median(alone, axis=0), np.median(batch, axis=0)
    summary = {
        "face_ms_p50": alone_ms[0],
        "face_ms_p99": np.percentile(alone[:, 0], 99),
        "face_rtf": alone[:, 0].mean() / (1000 * stream.config.step / FRAME_RATE_HZ),
        "face_wall_ms_p50": alone_ms[1],
        "sessions": sessions,
        "threads": threads(),
        "batch_ms_p50": batch_ms[0],
        "batch_wall_ms_p50": batch_ms[1],
        "batch_over_one": batch_ms[0] / alone_ms[0],
        "batch_over_one_wall": batch_ms[1] / alone_ms[1],
    }
    return {key: round(float(value), 4) for key, value in summary.items()}


def _chunks(stream: FaceStream, rows: int) -> Iterator[tuple[float, float]]:
    """Milliseconds of processor time and of wall time, chunk by chunk."""
    state, active, seeds = stream.init_state(rows), np.ones(rows, np.bool_), np.arange(rows)
    samples = stream.config.step * SAMPLES_PER_FRAME
    sound = 0.1 * np.random.default_rng(1).standard_normal((rows, samples), np.float32)
    between = evict_caches()
    while True:
        between()
        began, began_wall = time.process_time(), time.perf_counter()
        stream.step(sound, state, active, seeds)
        yield 1000 * (time.process_time() - began), 1000 * (time.perf_counter() - began_wall)


def evict_caches() -> Callable[[], None]:
    """A function to call before every timed step; it touches as much memory as the models do in a chunk.

    A stage timed by itself in a loop finds its data still in the caches. In a session the other models' weights have
    replaced it, so the isolated measurement would be far too optimistic.
    """
    weights = np.zeros(WEIGHTS, np.float32)
    return partial(np.add, weights, np.float32(1), out=weights)  # single-threaded
