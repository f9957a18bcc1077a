"""`echoavatar bench face`: what a face costs, encoder and frames apart, for one session and for many.

Times are of the processor, one thread: what other processes take away does not count. Weights do not matter to the
time, so a bundle without a face is timed with a random one of the default sizes.
"""

import time

import numpy as np
import torch

from ..face import FaceConfig, FaceModel, FaceStream
from ..timing import CHUNK_SAMPLES, SAMPLE_RATE_HZ

WARM_UP = 5
CHUNK_MS = 1000 * CHUNK_SAMPLES / SAMPLE_RATE_HZ


@torch.inference_mode()
def bench_face(model: FaceModel | None = None, *, chunks: int = 200, sessions: int = 64) -> dict[str, float]:
    """Milliseconds per chunk of 266.7 ms: one session (p50, p99, share of real time) and a batch of `sessions`."""
    stream = FaceStream(model or _random_face())
    one, many = _times(stream, 1, chunks), _times(stream, sessions, max(8, chunks // 10))
    summary = {
        "face_ms_p50": float(np.percentile(one, 50)),
        "face_ms_p99": float(np.percentile(one, 99)),
        "face_rtf": float(np.mean(one)) / CHUNK_MS,
        "sessions": float(sessions),
        "batch_ms_p50": float(np.percentile(many, 50)),
        "batch_over_one": float(np.percentile(many, 50) / np.percentile(one, 50)),
    }
    return {key: round(value, 4) for key, value in summary.items()}


def _random_face() -> FaceModel:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = FaceModel(FaceConfig())
    model.std.fill_(0.1)
    return model


def _times(stream: FaceStream, rows: int, chunks: int) -> list[float]:
    state, active, seeds = stream.init_state(rows), torch.ones(rows, dtype=torch.bool), torch.arange(rows)
    sound = 0.1 * torch.randn(rows, CHUNK_SAMPLES, generator=torch.Generator().manual_seed(1))
    times = []
    for _ in range(WARM_UP + chunks):
        began = time.process_time()
        stream.step(sound, state, active, seeds)
        times.append(1000 * (time.process_time() - began))
    return times[WARM_UP:]
