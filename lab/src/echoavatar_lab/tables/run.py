"""Makes a table by its name, with notes on how it was made.

Parts are made in several processes, in waves: what a wave needs, an earlier one has made. Each part is a function of
the experiment that leaves its result in the experiment's folder (`make_once`). The table is made afterwards in one
process and finds everything finished.
"""

import dataclasses
import math
import multiprocessing
import os
import subprocess
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, NamedTuple

import torch

from echoavatar.errors import EchoAvatarError

from . import alignment, beat2, latency, main, sound_probes, tokenizer_ablation, user_study
from .claims import judged
from .experiment import Experiment
from .latency import hardware
from .scale import Part
from .table import Table, orderings, over_seeds


class TableMaker(NamedTuple):
    """How a table is made. Tables that train have waves: the parts that several seeds and processes make."""

    make: Callable[[Any], Table]
    waves: Callable[[Any], Sequence[Sequence[Part]]] | None = None


TABLES = {
    tokenizer_ablation.NAME: TableMaker(tokenizer_ablation.make, tokenizer_ablation.waves),
    main.NAME: TableMaker(main.make, main.waves),
    beat2.NAME: TableMaker(beat2.make, beat2.waves),
    user_study.NAME: TableMaker(user_study.make, user_study.waves),
    main.LAYOUTS: TableMaker(main.make_orders, main.order_waves),
    latency.NAME: TableMaker(latency.make),
    alignment.NAME: TableMaker(alignment.make, alignment.waves),
    alignment.RETRIEVAL: TableMaker(alignment.make_retrieval, alignment.retrieval_waves),
    sound_probes.CODEC: TableMaker(sound_probes.make_codec),
    sound_probes.LABELS: TableMaker(sound_probes.make_labels),
}
NOTHING_LEARNED = "Scale tiny: a few steps of small models. It shows that every part runs; no number means anything."
FOREIGN = "Numbers of the paper are the paper's, not comparable: other data and extractor. Only order can be compared."
CHANCE = "Over chance: less what the same motion scores with the sound of other clips."
INTERVALS = "In brackets: 95 % intervals, resampling test clips; of training runs there is one seed."
PAPERS = {
    "codec": "Not the paper's: sound is heard by the default bundle's small codec, since no --codec was given.",
    "qwen": "Not the paper's: generators began with random weights, since no --qwen was given.",
}
SPREAD = "±: standard deviation over {} seeds of training and sampling, on one corpus; in brackets: 95 % over clips."


def reproduce(name: str, experiment: Experiment, *, command: str, seeds: int = 1, processes: int = 1) -> Table:
    """Make the table with all its notes. Finished parts are reused.

    With several `seeds` all is trained and sampled with each, from the experiment's own on; numbers are then means.
    `processes` make parts at a time.
    """
    make, waves = TABLES[name]
    experiment = beat2.Beat2Experiment.of(experiment) if name == beat2.NAME else experiment
    experiments = [experiment]
    if waves is not None:
        experiments += [experiment.again(seed=experiment.seed + more) for more in range(1, seeds)]
        if processes > 1:
            _ = experiment.test_clips  # the corpus, which all parts need
            make_in_waves(waves(experiment), experiments, processes)
    made = [make(one) for one in experiments]
    table = over_seeds(made) if len(made) > 1 else made[0]
    notes = list(table.notes)
    if waves is not None:  # the others need no corpus of motion
        notes += [FOREIGN] if any(line.paper for line in table.lines) else []
        if len(made) > 1:
            notes.append(SPREAD.format(len(made)))
        elif any(math.isfinite(cell.low) for line in table.lines for cell in line.ours.values()):
            notes.append(INTERVALS)
        notes += [CHANCE] if any(column.key.endswith("_over") for column in table.columns) else []
        notes += [*judged(table, made), *orderings(table)] if experiment.scale.name != "tiny" else [NOTHING_LEARNED]
        if experiment.scale.name == "paper":
            notes += [told for name, told in PAPERS.items() if getattr(experiment.sources, name) is None]
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


_device = "cpu"  # of this worker


def make_in_waves(waves: Sequence[Sequence[Part]], experiments: Sequence[Experiment], processes: int) -> None:
    """Make all parts of all experiments, as many at a time as there are processes.

    With `--device cuda` the processes take the machine's GPUs by turns. Raises EchoAvatarError if a part cannot be
    made, or a process was killed; finished parts are kept.
    """
    context = multiprocessing.get_context("spawn")
    turn = context.Value("i", 0)
    device, say = experiments[0].device, experiments[0].say
    pool = ProcessPoolExecutor(processes, context, initializer=_begin, initargs=(turn, processes, device))
    try:
        for number, wave in enumerate(waves, 1):
            jobs = [pool.submit(_make, part, one.again(is_quiet=True)) for one in experiments for part in wave]
            for done, job in enumerate(as_completed(jobs), 1):
                job.result()
                say(f"wave {number} of {len(waves)}: {done} of {len(jobs)} parts")
    except BrokenProcessPool as error:
        raise EchoAvatarError(
            "a process was killed, perhaps for lack of memory; the same call with fewer --processes goes on from here"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(turn: Any, processes: int, device: str) -> None:
    """Give this worker its share of the cores, and a GPU."""
    global _device
    with turn.get_lock():
        place, turn.value = turn.value, turn.value + 1
    torch.set_num_threads(max(1, (os.cpu_count() or 1) // processes))
    _device = f"cuda:{place % torch.cuda.device_count()}" if device == "cuda" and torch.cuda.is_available() else device


def _make(part: Part, experiment: Experiment) -> None:
    """Make a part on this worker's device; what it returns stays here."""
    part(experiment.again(device=_device, is_quiet=True))
