"""The paper's table "Real-time Performance Evaluation": milliseconds of each part for a chunk of 266 ms of sound.

Our numbers are for one session of the bundle that is asked for, on the device that is asked for. Without a bundle it is
the default one, and at scale `paper` one of the paper's sizes with random weights, because the time does not depend on
the weights: EnCodec, the tokenizer of 512 channels, Qwen2.5-0.5B in the order `prefix`, which reads its window anew at
every step, and the face with HuBERT.
"""

import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import torch

from echoavatar.bench.stream import StreamReport, bench_stream
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.bundle import Bundle
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.models.audio import CodecConfig
from echoavatar.models.face import FaceConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import BodyTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.nn.device import threads
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.models.face.train import paper_face
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import body_config
from echoavatar_lab.paper import CODEC

from .experiment import Experiment
from .scale import PAPER
from .table import Cell, Column, Line, Table


def hardware(device: str) -> str:
    """The name of the GPU, or of the processor with its cores."""
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    return f"{_processor()} ({threads()} of {os.cpu_count()} cores)"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


NAME = "latency"
PAPER_PARTS: Mapping[str, tuple[str, ...]] = {
    "Audio Encoder": ("level", "codec"),
    "Audio-to-Motion Model": ("generator",),
    "Motion Decoder": ("decoder",),
}
PAPER_MS = {
    "Audio Encoder": (51.155, 64.041),
    "Audio-to-Motion Model": (102.473, 118.932),
    "Motion Decoder": (1.532, 1.386),
    "IK Post-processing": (13.990, 20.86),
    "Total Latency": (177.426, 215.823),
}


class PaperSizes(NamedTuple):
    """Sizes of the paper's parts."""

    codec: CodecConfig
    tokenizer: BodyTokenizerConfig
    generator: GeneratorConfig
    face: FaceConfig


def paper_sizes() -> PaperSizes:
    """The paper's sizes on our rig; EnCodec with its own padding."""
    codec = CodecConfig(**CODEC["model"] | {"padding": "reflect"})
    sizes = PAPER.tokenizer
    layout = compact_layout(audio_codes=codec.codes, motion_layers=sizes.layers, motion_codes=sizes.codes)
    generator = PAPER.generator.model_copy(update={"layout": layout, "is_leveled": False})
    return PaperSizes(codec, body_config(HUMANOID, sizes), generator, paper_face())


def random_bundle(sizes: PaperSizes) -> Bundle:
    """A bundle of these sizes with random weights: to time it, not to look at.

    Raises DependencyError: transformers, which has HuBERT, is not installed.
    """
    return Bundle.of(
        "paper's sizes, random weights",
        Runtime(level_control=False),
        codec=AudioCodec(sizes.codec).eval(),
        tokenizer=BodyTokenizer(sizes.tokenizer).eval(),
        generator=Generator(sizes.generator).eval(),
        face=FaceModel(sizes.face).eval(),
    )


def make(experiment: Experiment) -> Table:
    """Measure the stages and make the table."""
    asked = experiment.sources.model
    is_paper = asked is None and experiment.scale.name == "paper"
    found = random_bundle(paper_sizes()) if is_paper else load_bundle(asked or "default")
    bundle = found.running(experiment.runtime)
    experiment.say(f"timing: {bundle.name}")
    pipeline = Pipeline(bundle, device=experiment.device)
    columns = (
        Column("h200", "NVIDIA H200, mean", "ms"),
        Column("rtx4090", "NVIDIA RTX 4090, mean", "ms"),
        Column("p50", f"{hardware(pipeline.device)}, median", "ms"),
        Column("p95", "95th percentile", "ms"),
    )
    report = bench_stream(pipeline, seconds=experiment.scale.seconds)
    lines = [Line(name, {"h200": h200, "rtx4090": rtx}, _cells(report, name)) for name, (h200, rtx) in PAPER_MS.items()]
    lines.append(Line("Face (not in the paper's sum)", {}, _summed(report, ("face",))))
    notes = (
        f"{bundle.name}: {bundle.parameters / 1e6:.1f} M parameters, one session,"
        f" {report.summary['threads']:.0f} threads, {report.summary['seconds']:.0f} s of sound.",
        "Medians of stages do not sum to the median of the whole, which has the face in it as well.",
        "The paper's numbers are the paper's, of other machines and its own models: not comparable.",
        "Codec, generator and decoder run on the device; the face and the stages behind the decoder on the processor.",
        "Spread over chunks is told by the 95th percentile; there are no clips to resample.",
    )
    return Table(NAME, "Latency of a chunk (paper, Real-time Performance Evaluation)", columns, lines, notes)


def _cells(report: StreamReport, name: str) -> dict[str, Cell]:
    if name == "Total Latency":
        return _summed(report, ("whole chunk",))
    if name in PAPER_PARTS:
        return _summed(report, PAPER_PARTS[name])
    known = {stage for stages in PAPER_PARTS.values() for stage in stages} | {"face", "whole chunk"}
    return _summed(report, tuple(stage for stage in report.stages_ms if stage not in known))


def _summed(report: StreamReport, stages: tuple[str, ...]) -> dict[str, Cell]:
    times = [report.stages_ms[stage] for stage in stages if report.stages_ms.get(stage)]
    return {"p50": Cell(sum(time[0] for time in times)), "p95": Cell(sum(time[1] for time in times))}
