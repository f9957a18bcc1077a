"""`echoavatar bench face`: what a face costs, for one session and for many, and what the many cannot cost less than.

One session and the batch take turns, so that neighbours on the machine slow both alike, and before every chunk the
caches are taken, as the other models do in a session (`between`). Times are of the processor
(all threads; what other processes take away does not count) and of the wall, of which the least is told, too, as the
time of a machine that has nothing else to do. The floor is the batch's matrix products
at the speed of one large product, one thread, in the same run; what is on top is reading keys and values, gates, and
mel bands. Weights do not matter to the time, so a bundle without a face is timed with a random one of default sizes.
"""

import time
from collections.abc import Iterator

import numpy as np
import torch
from torch import nn

from ..face import FaceConfig, FaceModel, FaceStream
from ..timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from .between import other_models

WARM_UP = 3
_TURNS = 10  # chunks of one session to one of the batch
_LARGE = 1024  # rows and columns of a product that runs at full speed


@torch.inference_mode()
def bench_face(model: FaceModel | None = None, *, chunks: int = 200, sessions: int = 64) -> dict[str, float]:
    """Milliseconds per step (ours: 266.7 ms of sound): one session, a batch of `sessions`, and the ratio of both."""
    model = model or _random_face()
    stream = FaceStream(model)
    one, many, speed = _chunks(stream, 1), _chunks(stream, sessions), _product_speeds()
    for _ in range(WARM_UP):
        next(one), next(many), next(speed)
    turns = max(3, chunks // _TURNS)
    ones, batches, speeds = [], [], []
    for _ in range(turns):
        ones += [next(one) for _ in range(_TURNS)]
        batches.append(next(many))
        speeds.append(next(speed))
    alone, batch = np.array(ones), np.array(batches)
    step_ms = 1000 * model.config.step / FRAME_RATE_HZ
    alone_ms, batch_ms = np.median(alone, axis=0), np.median(batch, axis=0)
    least_ms = alone[:, 1].min(), batch[:, 1].min()
    products = sessions * multiplications(model)
    summary = {
        "face_ms_p50": alone_ms[0],
        "face_ms_p99": np.percentile(alone[:, 0], 99),
        "face_rtf": alone[:, 0].mean() / step_ms,
        "face_wall_ms_p50": alone_ms[1],
        "sessions": sessions,
        "threads": torch.get_num_threads(),
        "batch_ms_p50": batch_ms[0],
        "batch_wall_ms_p50": batch_ms[1],
        "batch_over_one": batch_ms[0] / alone_ms[0],
        "batch_over_one_wall": batch_ms[1] / alone_ms[1],
        "face_wall_ms_least": least_ms[0],
        "batch_wall_ms_least": least_ms[1],
        "batch_over_one_wall_least": least_ms[1] / least_ms[0],
        "batch_gflop": 2e-9 * products,
        "batch_floor_ms": 1000 * products / float(np.median(speeds)),
    }
    return {key: round(float(value), 4) for key, value in summary.items()}


def multiplications(model: FaceModel) -> int:
    """Those in the matrix products of one session's chunk: both guidance branches, all steps of the sampler."""
    config, head = model.config, model.head
    steps = config.sampling_steps
    once = _weights(model.gpt.embed) + steps * _weights(head.noisy_proj)
    branch = _weights(model.gpt.blocks, model.gpt.output_proj, head.condition_proj)
    branch += steps * _weights(head.by_condition, head.mlps, head.output_proj)
    return config.step * (once + 2 * branch + _weights(model.gpt.sound_proj, model.encoder))


def _weights(*modules: nn.Module) -> int:
    """Of all projections inside."""
    inside = (part for module in modules for part in module.modules())
    return sum(part.weight.numel() for part in inside if isinstance(part, nn.Linear))


def _random_face() -> FaceModel:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = FaceModel(FaceConfig())
    model.std.fill_(0.1)
    return model


def _chunks(stream: FaceStream, rows: int) -> Iterator[tuple[float, float]]:
    """Milliseconds of the processor and of the wall, chunk by chunk."""
    state, active, seeds = stream.init_state(rows), torch.ones(rows, dtype=torch.bool), torch.arange(rows)
    sound = 0.1 * torch.randn(
        rows, stream.model.config.step * SAMPLES_PER_FRAME, generator=torch.Generator().manual_seed(1)
    )
    between = other_models()
    while True:
        between()
        began, began_wall = time.process_time(), time.perf_counter()
        stream.step(sound, state, active, seeds)
        yield 1000 * (time.process_time() - began), 1000 * (time.perf_counter() - began_wall)


def _product_speeds() -> Iterator[float]:
    """Multiplications per second of processor time in a large product."""
    matrix = torch.ones(_LARGE, _LARGE)
    while True:
        began = time.process_time()
        matrix @ matrix
        yield _LARGE**3 / (time.process_time() - began)
