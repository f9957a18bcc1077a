"""`echoavatar bench graphs`: an imported bundle's chunk on a GPU, every model stage one captured graph.

Paper, Table Real-time Performance Evaluation, whose stages these are; the face is not among them. The rig's inverse
kinematics runs on the host, as in the release. Without CUDA the same steps run plainly, which checks everything but
the capture and is no measurement of it.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import CheckpointError, EchoAvatarError
from ..generator.graphed import GraphedPrefix
from ..nn.graphs import Graphed
from ..pipeline import Bundle
from ..pipeline.rig import RigAdapter
from ..timing import SAMPLE_RATE_HZ, SAMPLES_PER_MOTION_TOKEN
from ..tokens import Prefix

GOALS_MS = {"encoder": 3.0, "generator": 30.0, "decoder": 1.0, "rig": 5.0, "total": 40.0}
PAPER_MS = {"encoder": 51.0, "generator": 102.0, "decoder": 1.5, "rig": 14.0, "total": 177.0}


@dataclass(frozen=True)
class GraphReport:
    """Milliseconds (p50, p95) of each stage of a chunk, and where."""

    stages_ms: dict[str, tuple[float, float]]
    device: str
    is_captured: bool
    chunk_ms: float


@torch.inference_mode()
def bench_graphs(bundle: Bundle, *, device: str = "cuda", chunks: int = 100) -> GraphReport:
    """Time `chunks` chunks of one session.

    Raises:
        EchoAvatarError: there is no such device.
        CheckpointError: the bundle was not imported: it has no prefix order, no opening, or our own rig.
    """
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise EchoAvatarError(
            "there is no CUDA device here; --device cpu runs the same steps without capture"
        )
    config = bundle.generator.config
    if config.opening is None or bundle.runtime.rig is None:
        raise CheckpointError(f"{bundle.name} is no imported bundle; `echoavatar bench stream` times any")
    order = config.order
    assert isinstance(order, Prefix)
    codec, tokenizer = bundle.codec.to(device), bundle.tokenizer.to(device)
    generator = bundle.generator.to(device)
    one = torch.ones(1, dtype=torch.bool, device=device)
    samples = config.step * SAMPLES_PER_MOTION_TOKEN
    sound, spoken = codec.init_state(1), tokenizer.init_decoder(1)
    codes = torch.zeros(1, config.step, 3, config.layout.motion_layers, dtype=torch.int64, device=device)
    encode = Graphed(
        lambda audio: codec.step(audio, sound, one), torch.zeros(1, samples, device=device), state=sound
    )
    decode = Graphed(lambda new: tokenizer.decode_step(new, spoken, one), codes, state=spoken)
    window = config.window_tokens
    audio_ids = torch.tensor(config.opening.silence, device=device).expand(1, window * 10, -1)
    motion = torch.full((1, window - config.step, *codes.shape[2:]), config.opening.motion, device=device)
    none_missing = torch.zeros(1, dtype=torch.int64, device=device)
    prompt, valid = order.prompt(audio_ids, motion, none_missing)
    dtype = torch.bfloat16 if device.startswith("cuda") else torch.float32
    draw = GraphedPrefix(generator, length=prompt.shape[1], dtype=dtype)
    rig = RigAdapter(bundle.runtime.rig, bundle.skeleton)
    placed, here = rig.init_state(1), torch.ones(1, dtype=torch.bool)
    heat = torch.full((1,), config.temperature, device=device)
    bias = torch.zeros(1, len(config.directed) * config.layout.motion_codes, device=device)
    laps = {stage: list[float]() for stage in GOALS_MS}
    random = torch.Generator().manual_seed(0)
    for index in range(chunks):
        new = 0.1 * torch.randn(1, samples, generator=random)
        begun = _now(device)

        def lap(stage: str, work: Callable[[], Tensor]) -> Tensor:
            before = _now(device)
            result = work()
            laps[stage].append(1e3 * (_now(device) - before))
            return result

        heard = lap("encoder", lambda new=new: encode(new.to(device)))  # type: ignore[misc]
        audio_ids = torch.cat([audio_ids, heard], 1)[:, heard.shape[1] :]

        def generate(audio: Tensor = audio_ids, past: Tensor = motion, step: int = index) -> Tensor:
            prompt, valid = order.prompt(audio, past, none_missing)
            count = torch.full_like(none_missing, step)
            return draw.step(prompt, valid, seeds=none_missing, heard=count, temperature=heat, bias=bias)

        codes = config.layout.unflatten(lap("generator", generate).clone())
        motion = torch.cat([motion, codes], 1)[:, config.step :]
        features = lap("decoder", lambda codes=codes: decode(codes))  # type: ignore[misc]
        lap("rig", lambda features=features: rig.step(features.cpu(), placed, here))  # type: ignore[misc]
        laps["total"].append(1e3 * (_now(device) - begun))
    counted = {stage: np.array(values[min(5, chunks - 1) :]) for stage, values in laps.items()}
    rows = {stage: (float(np.percentile(v, 50)), float(np.percentile(v, 95))) for stage, v in counted.items()}
    name = torch.cuda.get_device_name() if device.startswith("cuda") else "CPU"
    return GraphReport(rows, name, encode.is_captured, 1e3 * samples / SAMPLE_RATE_HZ)


def _now(device: str) -> float:
    """The clock, when the device has done what it was asked."""
    if device.startswith("cuda"):
        torch.cuda.synchronize()
    return time.perf_counter()
