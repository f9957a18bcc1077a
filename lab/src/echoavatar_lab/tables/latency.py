"""The paper's table "Real-time Performance Evaluation": milliseconds of each part for a chunk of 266 ms of sound.

Our numbers are for one session of the bundle that is asked for, on the device that is asked for. Without a bundle it is
the default one; then scale `paper` takes a generator of the paper's size with random weights, because the time does not
depend on the weights.
"""

import os
import platform
from collections.abc import Mapping
from pathlib import Path

import torch

from echoavatar.bench.stream import StreamReport, bench_stream
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.bundle import with_random_generator

from .experiment import Experiment
from .table import Cell, Column, Line, Table


def hardware(device: str) -> str:
    """The name of the GPU, or of the processor with its cores."""
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    return f"{_processor()} ({torch.get_num_threads()} of {os.cpu_count()} cores)"


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


def make(experiment: Experiment) -> Table:
    """Measure the stages and make the table."""
    asked = experiment.sources.model
    bundle = load_bundle(asked or "default").running(experiment.runtime)
    if asked is None and experiment.scale.name == "paper":
        bundle = with_random_generator(bundle)
    experiment.say(f"timing: {bundle.name}")
    pipeline = Pipeline(bundle, device=experiment.device)
    columns = (
        Column("h200", "NVIDIA H200, mean", "ms"),
        Column("rtx4090", "NVIDIA RTX 4090, mean", "ms"),
        Column("p50", f"{hardware(str(pipeline.device))}, median", "ms"),
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
