"""`echoavatar bench train`: the share of the machine's matrix rate that a training step reaches, measured in one run.

A step is the training loop's own (draw, loss, gradient, optimiser) on random codes and motion; time does not depend on
their content. Multiplications are counted by formula, as for docs/research.md: for each id 6 per weight of the layers
(forward and backward), and 12 L d S for attention over the S ids it may see. Recomputation, padding and the heads do
not count. The matrix rate is that of large square products in the step's number format.

A batch is drawn on the host before each step. Its share of the wall time is how long the device may have to wait.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch

from echoavatar.errors import EchoAvatarError
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import BodyTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK
from echoavatar_lab.data.corpus import ClipMotion
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.train import GeneratorTask, GeneratorTraining
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenizer.train import TokenizerTask, TokenizerTraining
from echoavatar_lab.training import Loop, TrainingTask
from echoavatar_lab.training.processes import Processes

SIZES = {"cuda": 8192, "cpu": 1024}  # side of the square matrices
PRODUCTS = 20
WARM_UP_STEPS = 2
CLIPS, CLIP_CHUNKS = 32, 60


class TrainReport(NamedTuple):
    """The measurements; rates in Tflop/s."""

    stage: str
    device: str
    number_format: str
    matrix_rate: float
    step_seconds: float
    draw_share: float  # share of the wall time spent drawing batches
    step_tflop: float | None  # counted work of a step; None if it is not counted
    share: float | None  # share of the matrix rate


def bench_generator(config: GeneratorConfig, training: GeneratorTraining, *, device: str, steps: int) -> TrainReport:
    """Time steps of the generator on random codes."""
    random = np.random.default_rng(0)
    layout, chunks = config.layout, max(CLIP_CHUNKS, training.chunks + config.ahead_chunks)
    clips = [
        TokenClip(
            random.integers(layout.audio_codes, size=(chunks * AUDIO_FRAMES_PER_CHUNK, layout.audio_layers)),
            random.integers(
                layout.motion_codes, size=(chunks * MOTION_TOKENS_PER_CHUNK, layout.parts, layout.motion_layers)
            ),
            np.ones(chunks * MOTION_TOKENS_PER_CHUNK, np.uint8),
        )
        for _ in range(CLIPS)
    ]
    stage = GeneratorTask(config, training, clips)
    ids = training.batch * stage.chunks * config.order.ids_per_chunk
    seen = config.order.lookback or stage.chunks * config.order.ids_per_chunk
    flop = None if config.sequence == "depth" else step_flop(stage.generator, ids, seen)  # two transformers in one
    return _timed("generator", stage, device=device, steps=steps, flop=flop)


def bench_tokenizer(
    config: BodyTokenizerConfig, training: TokenizerTraining, *, device: str, steps: int
) -> TrainReport:
    """Time steps of the tokenizer on random rotations; its work is not counted, because strides make that a guess."""
    random = np.random.default_rng(0)
    frames = max(300, 2 * training.frames)
    clips = []
    for _ in range(CLIPS):
        turns = random.normal(0, 0.1, (frames, HUMANOID.joints, 4)) + [1, 0, 0, 0]
        turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
        root = HUMANOID.offsets[0] + random.normal(0, 0.01, (frames, 3))
        clips.append(ClipMotion(turns.astype(np.float32), root.astype(np.float32)))
    return _timed("tokenizer", TokenizerTask(config, training, clips), device=device, steps=steps)


def step_flop(generator: Generator, ids: int, seen: int) -> float:
    """Counted work of a step over `ids` ids, each of which sees at most `seen` others."""
    config = generator.config
    weights = sum(weight.numel() for weight in generator.model.layers.parameters())
    return float(ids * (6 * weights + 12 * config.layers * config.width * seen))


def matrix_rate(device: str, dtype: torch.dtype) -> float:
    """Flop/s of square matrix products."""
    size = SIZES["cuda" if device.startswith("cuda") else "cpu"]
    a, b = (torch.randn(size, size, device=device, dtype=dtype) for _ in range(2))
    for _ in range(3):
        torch.mm(a, b)
    _wait(device)
    began = time.perf_counter()
    for _ in range(PRODUCTS):
        torch.mm(a, b)
    _wait(device)
    return PRODUCTS * 2.0 * size**3 / (time.perf_counter() - began)


def _timed(name: str, stage: TrainingTask[Any], *, device: str, steps: int, flop: float | None = None) -> TrainReport:
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise EchoAvatarError("there is no CUDA device here; --device cpu times the same steps")
    dtype = torch.bfloat16 if stage.config.autocast else torch.float32
    rate, loop = matrix_rate(device, dtype), Loop(stage, Processes(device))
    spent = _Clock(stage.draw)
    stage.draw = spent  # type: ignore[method-assign]
    for _ in range(WARM_UP_STEPS):
        loop.advance(is_logged=False)
    _wait(device)
    began, spent.seconds = time.perf_counter(), 0.0
    for _ in range(steps):
        loop.advance(is_logged=False)
    _wait(device)
    seconds = (time.perf_counter() - began) / steps
    return TrainReport(
        name,
        torch.cuda.get_device_name() if device.startswith("cuda") else "cpu",
        str(dtype).removeprefix("torch."),
        rate / 1e12,
        seconds,
        spent.seconds / steps / seconds,
        None if flop is None else flop / 1e12,
        None if flop is None else flop / seconds / rate,
    )


class _Clock:
    """Wraps a function and adds up the time spent in it."""

    def __init__(self, timed: Callable[[int], Any]) -> None:
        self._timed, self.seconds = timed, 0.0

    def __call__(self, step: int) -> Any:
        began = time.perf_counter()
        made = self._timed(step)
        self.seconds += time.perf_counter() - began
        return made


def _wait(device: str) -> None:
    if device.startswith("cuda"):
        torch.cuda.synchronize()
