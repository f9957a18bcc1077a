"""`echoavatar bench graphs`: a bundle's live step on a GPU, beside the times of the paper.

Paper, Table Real-time Performance Evaluation, whose stages these are; the face is not among them. What is timed is
`Pipeline.step`, whose generator is a captured CUDA graph. Without CUDA the same step runs plainly.
"""

import time
from dataclasses import dataclass

import numpy as np
import torch

from echoavatar.engine.pipeline import Bundle, Pipeline
from echoavatar.errors import EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ

GOALS_MS = {"encoder": 3.0, "generator": 30.0, "decoder": 1.0, "rig": 5.0, "total": 40.0}
PAPER_MS = {"encoder": 51.0, "generator": 102.0, "decoder": 1.5, "rig": 14.0, "total": 177.0}
WARM_UP = 5
_STAGES = {"codec": "encoder", "generator": "generator", "decoder": "decoder", "rig": "rig"}


@dataclass(frozen=True)
class GraphReport:
    """Milliseconds (p50, p95) of each stage of a chunk, and the device that took them."""

    stages_ms: dict[str, tuple[float, float]]
    device: str
    is_captured: bool
    chunk_ms: float


@torch.inference_mode()
def bench_graphs(bundle: Bundle, *, device: str = "cuda", chunks: int = 100) -> GraphReport:
    """Time `chunks` chunks of one session.

    Raises:
        EchoAvatarError: there is no such device.
    """
    is_cuda = device.startswith("cuda")
    if is_cuda and not torch.cuda.is_available():
        raise EchoAvatarError("there is no CUDA device here; --device cpu runs the same steps without capture")
    pipeline = Pipeline(bundle, device=device)
    state, everyone = pipeline.init_state(1), torch.ones(1, dtype=torch.bool)
    random, chunk_times = torch.Generator().manual_seed(0), list[dict[str, float]]()
    last = _now(is_cuda)

    def on_stage(stage: str) -> None:
        nonlocal last
        began, last = last, _now(is_cuda)
        if stage in _STAGES:
            chunk_times[-1][_STAGES[stage]] = 1e3 * (last - began)

    pipeline.on_stage = on_stage
    for _ in range(WARM_UP + chunks):
        chunk_times.append({})
        last = _now(is_cuda)
        pipeline.step(0.1 * torch.randn(1, pipeline.chunk.samples, generator=random), state, everyone)
    stages = {name: np.array([times[name] for times in chunk_times[WARM_UP:]]) for name in _STAGES.values()}
    stages["total"] = sum(stages.values(), np.zeros(chunks))
    rows = {name: (float(np.percentile(v, 50)), float(np.percentile(v, 95))) for name, v in stages.items()}
    name = torch.cuda.get_device_name() if is_cuda else "CPU"
    return GraphReport(rows, name, is_cuda, 1e3 * pipeline.chunk.samples / SAMPLE_RATE_HZ)


def _now(is_cuda: bool) -> float:
    """The time in seconds when the GPU has finished its work."""
    if is_cuda:
        torch.cuda.synchronize()
    return time.perf_counter()
