"""A whole dataset: survey, a pool of processes, packing as parts come in, and a report of what went wrong.

One bad recording stops nobody: it is reported by name. A stopped run is continued by the same call; recordings whose
files have not changed since are not done again.
"""

import logging
import multiprocessing
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import NamedTuple

import torch

from ..data import Corpus
from ..errors import EchoAvatarError
from .item import Receipt, finished_part, prepare_item, stamp
from .options import Options
from .pack import SetWriter, write_json
from .source import Item, Survey, with_splits

_log = logging.getLogger(__name__)
Progress = Callable[[int, int], None]


class Failure(NamedTuple):
    """A recording that could not be prepared, and why."""

    name: str
    why: str


class Outcome(NamedTuple):
    """What a run came to."""

    corpus: Corpus
    survey: Survey
    recordings: dict[str, Receipt]  # of the whole set
    made: tuple[str, ...]  # in this run
    kept: tuple[str, ...]  # that earlier runs had made
    failures: tuple[Failure, ...]
    seconds: float


def prepare(
    kind: str,
    survey: Survey,
    folder: Path,
    options: Options,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> Outcome:
    """Make or complete the set of a survey's recordings in `folder`, and write `report.json` there.

    Raises:
        EchoAvatarError: nothing could be prepared, the folder cannot be written or holds something else, or a worker
            was killed; what is finished is kept.
    """
    started = time.perf_counter()
    writer = SetWriter(folder, kind, survey.terms, options)
    _make(folder)
    items = with_splits(survey.items, options.test_every)
    writer.split({item.name: item.split for item in items})
    kept = [item for item in items if writer.has(item.name, stamp(item, options))]
    todo = [item for item in items if item not in kept]
    failures: list[Failure] = []
    made: list[str] = []
    state = "interrupted"
    try:
        for item, result in zip(todo, _results(todo, options, folder, workers), strict=True):
            if isinstance(result, Failure):
                failures.append(result)
            else:
                made.append(item.name)
                writer.add(result)
            if progress:
                progress(len(kept) + len(made) + len(failures), len(items))
        state = "finished"
    finally:
        if made or kept:
            writer.flush()
        _write_report(
            folder, state, survey, (made, [item.name for item in kept]), failures, writer.recordings
        )
    if not (made or kept):
        first = f"{failures[0].name}: {failures[0].why}" if failures else "no recording"
        raise EchoAvatarError(f"none of {len(items)} recordings could be prepared; {first}")
    corpus = writer.finish(split_words(survey, options))
    return Outcome(
        corpus,
        survey,
        writer.recordings,
        tuple(made),
        tuple(item.name for item in kept),
        tuple(failures),
        time.perf_counter() - started,
    )


def split_words(survey: Survey, options: Options) -> str:
    """Where the split comes from, for people."""
    if options.test_every is None:
        return survey.split_from
    return f"each {options.test_every}th by name" if options.test_every else "nothing held out"


def _make(folder: Path) -> None:
    try:
        (folder / "parts").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchoAvatarError(f"cannot write to {folder}: {error.strerror}; choose another -o") from error


def _results(
    items: Sequence[Item], options: Options, folder: Path, workers: int
) -> Iterator[Receipt | Failure]:
    """Receipts in the order of the items, whoever makes them."""
    if workers <= 1 or len(items) <= 1:
        yield from (_attempt(item, options, folder) for item in items)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers, len(items)), context, initializer=_settle)
    try:
        futures: list[Future[Receipt | Failure]] = [
            pool.submit(_attempt, item, options, folder) for item in items
        ]
        for future in futures:
            yield future.result()
    except BrokenProcessPool as error:
        raise EchoAvatarError(
            "a worker was killed, perhaps for want of memory; run again with fewer --workers, it goes on from here"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _settle() -> None:
    """In each worker: one thread, and Ctrl-C is the parent's to handle."""
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _attempt(item: Item, options: Options, folder: Path) -> Receipt | Failure:
    """The part of one recording, made or found finished; trouble becomes a `Failure`."""
    found = finished_part(folder, item.name)
    if found is not None and found.stamp == stamp(item, options):
        return found.model_copy(update={"split": item.split})
    try:
        return prepare_item(item, options, folder)
    except EchoAvatarError as error:
        return Failure(item.name, " ".join(str(error).split()))
    except Exception as error:  # a recording that we did not foresee must not stop the others
        _log.exception("%s could not be prepared", item.name)
        return Failure(item.name, f"unforeseen, please report it: {type(error).__name__}: {error}")


def _write_report(
    folder: Path,
    state: str,
    survey: Survey,
    names: tuple[Sequence[str], Sequence[str]],
    failures: Sequence[Failure],
    recordings: dict[str, Receipt],
) -> None:
    write_json(
        folder / "report.json",
        {
            "state": state,
            "dataset": survey.terms.title,
            "made": list(names[0]),
            "kept": list(names[1]),
            "failed": {failure.name: failure.why for failure in failures},
            "left_out": {one.name: one.why for one in survey.left_out},
            "missing": list(survey.missing),
            "notes": {name: list(one.notes) for name, one in recordings.items() if one.notes},
            "mended_hands": {name: list(one.mended) for name, one in recordings.items() if one.mended},
            "fidelity": {name: one.fidelity for name, one in recordings.items() if one.fidelity},
        },
    )
