"""Runs training from the start, or from the last checkpoint, to the end or to the next interruption.

On SIGTERM or SIGINT a run finishes its step and saves a checkpoint; a second signal ends it at once.
"""

import math
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Self, TypeVar

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.held_folder import hold_folder
from echoavatar_lab.progress import Progress

from .loop import Loop
from .metrics_log import MetricsLog
from .processes import Processes, processes_here
from .state import has_state
from .task import TrainingTask

_ASKED = (signal.SIGTERM, signal.SIGINT)


class Interrupted(KeyboardInterrupt):  # noqa: N818  (like KeyboardInterrupt: not an error)
    """A run was asked to end and has been saved. `code` is the shell's exit code for the signal."""

    def __init__(self, message: str, number: int) -> None:
        super().__init__(message)
        self.code = 128 + number


class Signals(ExitStack):
    """Context that records the first signal in `number` and then restores the previous handlers.

    Python delivers signals to the main thread only; entered in another thread this does nothing.
    """

    number = 0

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for which in _ASKED:
                self.callback(signal.signal, which, signal.signal(which, self._note))
        return self

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.number = number
        self.close()


TaskT = TypeVar("TaskT", bound=TrainingTask[Any])


def train(
    stage: TaskT,
    folder: Path,
    *,
    start: Any = None,
    minutes: float | None = None,
    device: str = "cpu",
    sharded: bool = False,
    trackers: Sequence[str] = (),
    progress: Progress | None = None,
) -> TaskT:
    """Train, or resume the run in `folder`, until the schedule's end, or for `minutes` of this call.

    `folder` gets what the task saves, `training.safetensors` (for resuming) and `metrics.jsonl`. A new run begins with
    the weights of `start`, where given (`TrainingTask.begin_with`), under a schedule of its own. Returns the task; its
    modules are then in eval mode.

    Raises:
        Interrupted: SIGTERM or SIGINT arrived; the run is saved and can be resumed.
        CheckpointError: the folder holds another run, or a damaged one; or `start` is of other sizes.
        EchoAvatarError: the loss is not finite, the batch cannot be divided evenly, another run trains in `folder`, or
            the disk is full; what was saved is whole, and the call can be repeated.
    """
    if start is not None and not has_state(folder):
        stage.begin_with(start)
    processes = processes_here(device, sharded=sharded)
    loop = Loop(stage, processes)
    with _alone_in(folder, processes):
        loop.resume(folder)
        metrics_log = MetricsLog(folder, loop.step, trackers) if processes.is_first else None
        deadline = math.inf if minutes is None else time.monotonic() + 60 * minutes
        try:
            with Signals() as signals:
                _run(loop, folder, metrics_log, signals, deadline, progress)
                loop.save(folder)
        finally:
            if metrics_log is not None:
                metrics_log.close()
    if signals.number and loop.done() < 1:
        raise Interrupted(
            f"stopped at step {loop.step} of {stage.config.steps}, saved in {folder}; call again to resume",
            signals.number,
        )
    for module in stage.modules.values():
        module.eval()
    return stage


@contextmanager
def _alone_in(folder: Path, processes: Processes) -> Iterator[None]:
    """Hold the folder for all processes of this run; where it is refused, it is refused in each of them."""
    with ExitStack() as held:
        refusal = ""
        if processes.is_first:
            try:
                held.enter_context(hold_folder(folder))
            except EchoAvatarError as error:
                refusal = str(error)
        if refusals := "".join(processes.gather_json(refusal)):
            raise EchoAvatarError(refusals)
        yield


def _run(
    loop: Loop[Any],
    folder: Path,
    metrics_log: MetricsLog | None,
    signals: Signals,
    deadline: float,
    progress: Progress | None,
) -> None:
    config, saved = loop.stage.config, time.monotonic()
    agreed = loop.processes.agree
    while loop.done() < 1 and not agreed(bool(signals.number) or time.monotonic() >= deadline):
        began = time.monotonic()
        is_logged = (loop.step + 1) % config.log_every == 0
        is_kept = config.save_every > 0 and (loop.step + 1) % config.save_every == 0
        # a checkpoint needs the check that the loss is finite
        metrics = loop.advance(is_logged=is_logged or is_kept)
        seconds = time.monotonic() - began
        if config.minutes:  # the schedule depends on time, so all processes must use one clock
            seconds = loop.processes.gather_json(seconds)[0]
        loop.seconds += seconds
        is_measured = config.evaluate_every and loop.step % config.evaluate_every == 0 and loop.done() < 1
        if metrics_log is not None and is_logged:
            metrics_log.write(loop.step, metrics | {"seconds": round(seconds, 4)})
        if is_measured:
            with loop.shown():
                measured = loop.stage.evaluate() if metrics_log is not None else {}
            if metrics_log is not None and measured:
                metrics_log.write(loop.step, measured)
        is_due = config.save_minutes and time.monotonic() - saved > 60 * config.save_minutes
        if is_kept or agreed(bool(is_due)):
            loop.save(folder)
            saved = time.monotonic()
        if progress is not None and loop.processes.is_first:
            progress(loop.step, config.steps)
