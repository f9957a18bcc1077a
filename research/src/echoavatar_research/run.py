"""Makes a table by its name, with notes on how it was made."""

import dataclasses
import os
import platform
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from . import (
    alignment,
    beat2,
    codec_probes,
    dataset_composition,
    latency,
    layouts,
    main,
    sound_labels,
    tokenizer_ablation,
)
from .beat2_experiment import Beat2Experiment
from .experiment import Experiment
from .table import Table, orderings

TABLES: dict[str, Callable[[Any], Table]] = {
    tokenizer_ablation.NAME: tokenizer_ablation.make,
    main.NAME: main.make,
    beat2.NAME: beat2.make,
    dataset_composition.NAME: dataset_composition.make,
    layouts.NAME: layouts.make,
    latency.NAME: latency.make,
    alignment.NAME: alignment.make,
    codec_probes.NAME: codec_probes.make,
    sound_labels.NAME: sound_labels.make,
}
NOTHING_LEARNED = "Scale tiny: a few steps of small models. It shows that every part runs; no number means anything."
FOREIGN = "Numbers of the paper are the paper's, not comparable: other data and extractor. Only order can be compared."
CHANCE = "Over chance: less what the same motion scores with the sound of other clips."
INTERVALS = "In brackets: 95 % intervals, resampling test clips; of training runs there is one seed."


def reproduce(name: str, experiment: Experiment, *, command: str) -> Table:
    """Make the table with all its notes. Finished parts are reused."""
    experiment = Beat2Experiment.of(experiment) if name == beat2.NAME else experiment
    table = TABLES[name](experiment)
    notes = list(table.notes)
    if name not in (latency.NAME, codec_probes.NAME, sound_labels.NAME):  # these need no corpus of motion
        notes += [FOREIGN] if any(line.paper for line in table.lines) else []
        notes.append(INTERVALS)
        notes += [CHANCE] if any(column.key.endswith("_over") for column in table.columns) else []
        notes += orderings(table) if experiment.scale.name != "tiny" else [NOTHING_LEARNED]
        notes.append(f"{len(experiment.test_clips)} test clips of {_about(experiment)}.")
    notes.append(f"Made by `{command}` on {hardware(experiment.device)}; commit {commit()}; seed {experiment.seed}.")
    if name not in (codec_probes.NAME, sound_labels.NAME):
        how = "none: codes decoded alone" if name == beat2.NAME else experiment.runtime
        notes.append(f"Runtime: {how}.")
    return dataclasses.replace(table, notes=notes)


def commit() -> str:
    """The commit of this checkout, with a plus where files differ from it; `unknown` outside of one."""
    words = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def hardware(device: str) -> str:
    """The name of the GPU, or of the processor with its cores."""
    if device.startswith("cuda"):
        return torch.cuda.get_device_name()
    return f"{_processor()} ({torch.get_num_threads()} of {os.cpu_count()} cores)"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _about(experiment: Experiment) -> str:
    info = experiment.corpus.manifest.info
    minutes = experiment.corpus.frames() / 30 / 60
    return f"{info.get('kind') or experiment.corpus.folder.name}, {minutes:.0f} minutes in all"
