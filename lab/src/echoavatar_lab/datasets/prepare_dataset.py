"""Prepares a whole dataset: processes its recordings in a pool, writes the set and a report.

A bad recording is reported by name and does not stop the others. The same call continues an interrupted run; a
recording whose files have not changed is not processed again. `forecast` tells what a run would do, from file headers
alone.
"""

import logging
import multiprocessing
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import NamedTuple

import av
import torch

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.models.audio.files import decoded, open_sound
from echoavatar.motion.formats.bvh import stated_length
from echoavatar.motion.formats.tables import NpzArrays
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.data import Corpus
from echoavatar_lab.held_folder import hold_folder
from echoavatar_lab.progress import Progress

from .prepare_recording import Receipt, finished_part, prepare_recording, sound_file, stamp
from .set_writer import SetWriter, write_json
from .source import Recording, SetOptions, Survey, with_splits

_log = logging.getLogger(__name__)


class Failure(NamedTuple):
    """A recording that could not be prepared, and why."""

    name: str
    why: str


class Outcome(NamedTuple):
    """Result of a run."""

    corpus: Corpus
    receipts: dict[str, Receipt]  # of the whole set
    made: tuple[str, ...]  # in this run
    kept: tuple[str, ...]  # that earlier runs had made
    failures: tuple[Failure, ...]
    seconds: float


def prepare(
    kind: str, survey: Survey, folder: Path, options: SetOptions, *, workers: int = 1, progress: Progress | None = None
) -> Outcome:
    """Make or complete the set of a survey's recordings in `folder`, and write `report.json` there.

    Raises EchoAvatarError: nothing could be prepared, the folder cannot be written or holds something else, or a
    worker was killed; finished parts are kept.
    """
    started = time.perf_counter()
    with hold_folder(folder):
        writer = SetWriter(folder, kind, survey.terms, options)
        make_output_folder(folder / "parts")
        recordings = with_splits(survey.recordings, options.test_every)
        writer.assign_splits({recording.name: recording.split for recording in recordings})
        kept = [one.name for one in recordings if writer.holds(one.name, stamp(one, options))]
        todo = [recording for recording in recordings if recording.name not in kept]
        failures: list[Failure] = []
        made: list[str] = []
        state = "interrupted"
        try:
            for recording, result in zip(todo, _results(todo, options, folder, workers), strict=True):
                if isinstance(result, Failure):
                    failures.append(result)
                else:
                    made.append(recording.name)
                    writer.add(result)
                if progress:
                    progress(len(kept) + len(made) + len(failures), len(recordings))
            state = "finished"
        finally:
            if made or kept:
                writer.flush()
            _write_report(folder, state, survey, (made, kept), failures, writer.receipts)
        if not (made or kept):
            first = f"{failures[0].name}: {failures[0].why}" if failures else "no recording"
            raise EchoAvatarError(f"none of {len(recordings)} recordings could be prepared; {first}")
        corpus = writer.finish(split_source(survey, options))
        return Outcome(
            corpus, writer.receipts, tuple(made), tuple(kept), tuple(failures), time.perf_counter() - started
        )


def split_source(survey: Survey, options: SetOptions) -> str:
    """A description of where the split comes from."""
    if options.test_every is None:
        return survey.split_from
    return f"one in {options.test_every} by name" if options.test_every else "nothing held out"


def _results(
    recordings: Sequence[Recording], options: SetOptions, folder: Path, workers: int
) -> Iterator[Receipt | Failure]:
    """Receipts or failures in the order of the recordings."""
    if workers <= 1 or len(recordings) <= 1:
        yield from (_attempt(recording, options, folder) for recording in recordings)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers, len(recordings)), context, initializer=_set_up_worker)
    try:
        futures: list[Future[Receipt | Failure]] = [
            pool.submit(_attempt, recording, options, folder) for recording in recordings
        ]
        for future in futures:
            yield future.result()
    except BrokenProcessPool as error:
        raise EchoAvatarError(
            "a worker was killed, perhaps for lack of memory; run again with fewer --workers to continue from here"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _set_up_worker() -> None:
    """In each worker, use one thread and leave Ctrl-C to the parent process."""
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _attempt(recording: Recording, options: SetOptions, folder: Path) -> Receipt | Failure:
    """Make the part of one recording, or find it finished; an error becomes a `Failure`."""
    found = finished_part(folder, recording.name)
    if found is not None and found.stamp == stamp(recording, options):
        return found.model_copy(update={"split": recording.split})
    try:
        return prepare_recording(recording, options, folder)
    except EchoAvatarError as error:
        return Failure(recording.name, " ".join(str(error).split()))
    except Exception as error:  # a bug in one recording must not stop the others
        _log.exception("%s could not be prepared", recording.name)
        return Failure(recording.name, f"unexpected, please report it: {type(error).__name__}: {error}")


def _write_report(
    folder: Path,
    state: str,
    survey: Survey,
    names: tuple[Sequence[str], Sequence[str]],
    failures: Sequence[Failure],
    receipts: dict[str, Receipt],
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
            "notes": {name: list(one.notes) for name, one in receipts.items() if one.notes},
            "mended_hands": {name: list(one.mended) for name, one in receipts.items() if one.mended},
            "fidelity": {name: one.fidelity for name, one in receipts.items() if one.fidelity},
        },
    )


BYTES_PER_FRAME = 52 * 16 + 12 + 1  # motion on our rig


class Forecast(NamedTuple):
    """What a run would make."""

    seconds: dict[str, float]  # by split
    clips: dict[str, int]
    failures: tuple[Failure, ...]
    bytes: int


def forecast(recordings: Sequence[Recording], options: SetOptions) -> Forecast:
    """Read the headers of all recordings; write nothing."""
    seconds: dict[str, float] = {}
    clips: dict[str, int] = {}
    failures: list[Failure] = []
    size = 0
    for recording in with_splits(recordings, options.test_every):
        try:
            lasts, has_sound = _seconds(recording, options)
        except EchoAvatarError as error:
            failures.append(Failure(recording.name, " ".join(str(error).split())))
            continue
        seconds[recording.split] = seconds.get(recording.split, 0.0) + lasts
        clips[recording.split] = clips.get(recording.split, 0) + 1
        size += int(lasts * FRAME_RATE_HZ) * (BYTES_PER_FRAME + (2 * SAMPLES_PER_FRAME if has_sound else 0))
    return Forecast(seconds, clips, tuple(failures), size)


def _seconds(recording: Recording, options: SetOptions) -> tuple[float, bool]:
    frames, fps = motion_header(recording.motion)
    moves = frames / fps
    if (sound := sound_file(recording, options)) is None:
        return moves, False
    sounds = sound_seconds(sound)
    if abs(moves - sounds) > options.length_tolerance * max(moves, sounds):
        raise MotionError(
            f"{recording.motion.name} lasts {moves:.1f} s at {fps:g} frames per second, its sound {sounds:.1f} s"
        )
    return min(moves, sounds), True


def motion_header(path: Path) -> tuple[int, float]:
    """Frames and frame rate of a BVH or SMPL-X npz. Raises MotionError if the file is missing or has no such header."""
    if path.suffix.lower() != ".npz":
        return stated_length(path)
    try:
        with NpzArrays(path, MotionError) as stored:
            rate = stored.get("mocap_frame_rate", 30.0)
            return len(stored["trans"]), float(rate)
    except (OSError, ValueError, KeyError) as error:
        raise MotionError(f"{path} cannot be read ({error}); fetch it again") from error


def sound_seconds(path: Path) -> float:
    """Length of a sound file in seconds, from its header if that states it. Raises MotionError if it is not sound."""
    try:
        with open_sound(path) as container:
            lasts = container.duration
    except av.FFmpegError as error:
        raise MotionError(f"{path} is not a sound file ({error.strerror}); fetch it again") from error
    if not lasts:  # as recorded live
        return sum(len(piece.samples) / piece.form.rate for piece in decoded(path, 0))
    return float(lasts) / av.time_base
