"""Makes the parts of a table in several processes, in waves: what a wave needs, an earlier one has made.

Each part is a function of the experiment that leaves its result in the experiment's folder (`make_once`). The table is
made afterwards in one process, as without waves, and finds everything finished.
"""

import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from operator import methodcaller
from typing import Any

import torch

from echoavatar.errors import EchoAvatarError

from .choices import GeneratorChoice
from .experiment import Experiment

Part = Callable[[Any], object]
"""Makes one part of an experiment; a module's function, a partial of one, or a `methodcaller`, which can be pickled."""
_device = "cpu"  # of this worker


def generator_waves(choices: Iterable[GeneratorChoice]) -> list[Sequence[Part]]:
    """Tokenizers with their codes; stage 1; motion of the generators of stage 2; of those that go on from them."""
    chosen = list({choice.name: choice for choice in choices}.values())
    tokenizers = {choice.tokenizer.name: choice.tokenizer for choice in chosen}
    firsts = {choice.first_stage.name: choice.first_stage for choice in chosen}
    return [
        [methodcaller("codes", tokenizer) for tokenizer in tokenizers.values()],
        [methodcaller("embeddings", first) for first in firsts.values()],
        [methodcaller("generated_motions", choice) for choice in chosen if choice.after is None],
        [methodcaller("generated_motions", choice) for choice in chosen if choice.after is not None],
    ]


def make_in_waves(waves: Sequence[Sequence[Part]], experiments: Sequence[Experiment], processes: int) -> None:
    """Make all parts of all experiments, as many at a time as there are processes.

    With `--device cuda` the processes take the machine's GPUs by turns.

    Raises:
        EchoAvatarError: a part cannot be made, or a process was killed; finished parts are kept.
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
