"""Makes a table by its name, with notes on how it was made."""

import dataclasses
import math
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from . import (
    alignment,
    beat2,
    codec_probes,
    dataset_composition,
    latency,
    layouts,
    main,
    retrieval,
    runtimes,
    sound_labels,
    tokenizer_ablation,
)
from .beat2_experiment import Beat2Experiment
from .experiment import Experiment
from .hardware import hardware
from .table import Table, orderings, over_seeds
from .waves import Part, make_in_waves

TABLES: dict[str, Callable[[Any], Table]] = {
    tokenizer_ablation.NAME: tokenizer_ablation.make,
    main.NAME: main.make,
    beat2.NAME: beat2.make,
    dataset_composition.NAME: dataset_composition.make,
    layouts.NAME: layouts.make,
    runtimes.NAME: runtimes.make,
    latency.NAME: latency.make,
    alignment.NAME: alignment.make,
    retrieval.NAME: retrieval.make,
    codec_probes.NAME: codec_probes.make,
    sound_labels.NAME: sound_labels.make,
}
WAVES: dict[str, Callable[[Any], Sequence[Sequence[Part]]]] = {
    module.NAME: module.waves
    for module in (tokenizer_ablation, main, beat2, dataset_composition, layouts, runtimes, alignment, retrieval)
}
"""The parts of the tables that train; only these have several seeds and take several processes."""
NOTHING_LEARNED = "Scale tiny: a few steps of small models. It shows that every part runs; no number means anything."
FOREIGN = "Numbers of the paper are the paper's, not comparable: other data and extractor. Only order can be compared."
CHANCE = "Over chance: less what the same motion scores with the sound of other clips."
INTERVALS = "In brackets: 95 % intervals, resampling test clips; of training runs there is one seed."
SPREAD = "±: standard deviation over {} seeds, of training and of sampling, on one corpus; in brackets: 95 % intervals."


def reproduce(name: str, experiment: Experiment, *, command: str, seeds: int = 1, processes: int = 1) -> Table:
    """Make the table with all its notes. Finished parts are reused.

    With several `seeds` all is trained and sampled with each, from the experiment's own on; numbers are then means.
    `processes` make parts at a time.
    """
    experiment = Beat2Experiment.of(experiment) if name == beat2.NAME else experiment
    experiments = [experiment]
    if name in WAVES:
        experiments += [experiment.again(seed=experiment.seed + more) for more in range(1, seeds)]
        if processes > 1:
            _ = experiment.test_clips  # the corpus, which all parts need
            make_in_waves(WAVES[name](experiment), experiments, processes)
    made = [TABLES[name](one) for one in experiments]
    table = over_seeds(made) if len(made) > 1 else made[0]
    notes = list(table.notes)
    if name in WAVES:  # the others need no corpus of motion
        notes += [FOREIGN] if any(line.paper for line in table.lines) else []
        if len(made) > 1:
            notes.append(SPREAD.format(len(made)))
        elif any(math.isfinite(cell.low) for line in table.lines for cell in line.ours.values()):
            notes.append(INTERVALS)
        notes += [CHANCE] if any(column.key.endswith("_over") for column in table.columns) else []
        is_finished = name == runtimes.NAME and bool(experiment.sources.model)  # a bundle, which no scale trained
        if not is_finished:
            notes += orderings(table) if experiment.scale.name != "tiny" else [NOTHING_LEARNED]
        notes.append(f"{len(experiment.test_clips)} test clips of {_about(experiment)}.")
    notes.append(f"Made by `{command}` on {hardware(experiment.device)}; commit {commit()}; {_seeds(experiments)}.")
    if name not in (codec_probes.NAME, sound_labels.NAME):
        told = {beat2.NAME: "none: codes decoded alone", runtimes.NAME: "as the line says"}
        how = told.get(name, experiment.runtime)
        notes.append(f"Runtime: {how}.")
    return dataclasses.replace(table, notes=notes)


def _seeds(experiments: Sequence[Experiment]) -> str:
    seeds = [str(one.seed) for one in experiments]
    return f"seed{'s' * (len(seeds) > 1)} {', '.join(seeds)}"


def commit() -> str:
    """The commit of this checkout, with a plus where files differ from it; `unknown` outside of one."""
    words = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _about(experiment: Experiment) -> str:
    info = experiment.corpus.manifest.info
    minutes = experiment.corpus.frames() / 30 / 60
    return f"{info.get('kind') or experiment.corpus.folder.name}, {minutes:.0f} minutes in all"
