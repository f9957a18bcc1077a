"""Makes a table and writes it: Markdown, CSV, LaTeX, a picture, and what it was made with."""

import dataclasses
import os
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from . import alignment, beat2, dataset_composition, latency, layouts, main, tokenizer_ablation
from .beat2_workshop import Beat2Workshop
from .figure import draw
from .table import Table, orderings
from .text import as_csv, latex, markdown
from .workshop import Workshop

TABLES: dict[str, Callable[[Any], Table]] = {
    tokenizer_ablation.NAME: tokenizer_ablation.make,
    main.NAME: main.make,
    beat2.NAME: beat2.make,
    dataset_composition.NAME: dataset_composition.make,
    layouts.NAME: layouts.make,
    latency.NAME: latency.make,
    alignment.NAME: alignment.make,
}
NOTHING_LEARNED = (
    "Scale tiny: a few steps of small models. It shows that every part runs; no number means anything."
)
FOREIGN = "Numbers of the paper are the paper's, not comparable: other data and extractor. Only order can be compared."
CHANCE = "Over chance: less what the same motion scores with the sound of other clips."
INTERVALS = "In brackets: 95 % intervals, resampling test clips; of training runs there is one seed."


def reproduce(name: str, workshop: Workshop, *, command: str) -> Table:
    """Make the table with all notes; parts that are finished are kept."""
    workshop = Beat2Workshop.of(workshop) if name == beat2.NAME else workshop
    table = TABLES[name](workshop)
    notes = list(table.notes)
    if name != latency.NAME:
        notes += [FOREIGN] if any(line.paper for line in table.lines) else []
        notes.append(INTERVALS)
        notes += [CHANCE] if any(column.key.endswith("_over") for column in table.columns) else []
        notes += orderings(table) if workshop.scale.name != "tiny" else [NOTHING_LEARNED]
        notes.append(f"{len(workshop.tests)} test clips of {_about(workshop)}.")
    notes.append(f"Made by `{command}` on {hardware(workshop.device)}; seed {workshop.seed}.")
    return dataclasses.replace(table, notes=notes)


def write(table: Table, folder: Path) -> list[Path]:
    """Write `NAME.md`, `.csv`, `.tex` and `.png`; the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{table.name}{suffix}" for suffix in (".md", ".csv", ".tex", ".png")]
    for path, text in zip(paths, (markdown(table), as_csv(table), latex(table)), strict=False):
        path.write_text(text, encoding="utf-8")
    draw(table, paths[-1])
    return paths


def hardware(device: str) -> str:
    """What it ran on."""
    if device.startswith("cuda"):
        return torch.cuda.get_device_name()
    return f"{_processor()} ({torch.get_num_threads()} of {os.cpu_count()} cores)"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _about(workshop: Workshop) -> str:
    info = workshop.corpus.manifest.info
    minutes = workshop.corpus.frames() / 30 / 60
    return f"{info.get('kind') or workshop.corpus.folder.name}, {minutes:.0f} minutes in all"
