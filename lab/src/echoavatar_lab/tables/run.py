"""Makes a table by its name, with notes on how it was made."""

import dataclasses
import math
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from . import alignment, beat2, latency, main, sound_probes, tokenizer_ablation, user_study
from .experiment import Experiment
from .latency import hardware
from .table import Table, orderings, over_seeds


class TableMaker(NamedTuple):
    """How a table is made, and whether models are trained for it, which several seeds repeat."""

    make: Callable[[Any], Table]
    is_trained: bool = True


TABLES = {
    tokenizer_ablation.NAME: TableMaker(tokenizer_ablation.make),
    main.NAME: TableMaker(main.make),
    beat2.NAME: TableMaker(beat2.make),
    user_study.NAME: TableMaker(user_study.make),
    main.LAYOUTS: TableMaker(main.make_orders),
    latency.NAME: TableMaker(latency.make, is_trained=False),
    alignment.NAME: TableMaker(alignment.make),
    alignment.RETRIEVAL: TableMaker(alignment.make_retrieval),
    sound_probes.CODEC: TableMaker(sound_probes.make_codec, is_trained=False),
    sound_probes.LABELS: TableMaker(sound_probes.make_labels, is_trained=False),
}
NOTHING_LEARNED = "Scale tiny: a few steps of small models. It shows that every part runs; no number means anything."
FOREIGN = "Numbers of the paper are the paper's, not comparable: other data and extractor. Only order can be compared."
CHANCE = "Over chance: less what the same motion scores with the sound of other clips."
INTERVALS = "In brackets: 95 % intervals, resampling test clips; of training runs there is one seed."
SPREAD = "±: standard deviation over {} seeds, of training and of sampling, on one corpus; in brackets: 95 % intervals."


def reproduce(name: str, experiment: Experiment, *, command: str, seeds: int = 1) -> Table:
    """Make the table with all its notes. Finished parts are reused.

    With several `seeds` all is trained and sampled with each, from the experiment's own on; numbers are then means.
    """
    make, is_trained = TABLES[name]
    experiment = beat2.Beat2Experiment.of(experiment) if name == beat2.NAME else experiment
    experiments = [experiment]
    if is_trained:
        experiments += [experiment.again(experiment.seed + more) for more in range(1, seeds)]
    made = [make(one) for one in experiments]
    table = over_seeds(made) if len(made) > 1 else made[0]
    notes = list(table.notes)
    if is_trained:  # the others need no corpus of motion
        notes += [FOREIGN] if any(line.paper for line in table.lines) else []
        if len(made) > 1:
            notes.append(SPREAD.format(len(made)))
        elif any(math.isfinite(cell.low) for line in table.lines for cell in line.ours.values()):
            notes.append(INTERVALS)
        notes += [CHANCE] if any(column.key.endswith("_over") for column in table.columns) else []
        notes += orderings(table) if experiment.scale.name != "tiny" else [NOTHING_LEARNED]
        notes.append(f"{len(experiment.test_clips)} test clips of {_about(experiment)}.")
    used = ("seeds " if len(experiments) > 1 else "seed ") + ", ".join(str(one.seed) for one in experiments)
    notes.append(f"Made by `{command}` on {hardware(experiment.device)}; commit {commit()}; {used}.")
    if name not in (sound_probes.CODEC, sound_probes.LABELS):
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


def _about(experiment: Experiment) -> str:
    info = experiment.corpus.manifest.info
    minutes = experiment.corpus.frames() / 30 / 60
    return f"{info.get('kind') or experiment.corpus.folder.name}, {minutes:.0f} minutes in all"
