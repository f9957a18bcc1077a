"""Logs a run's metrics: `metrics.jsonl` always, one line for each logged step; TensorBoard or W&B if asked."""

import importlib.util
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic_core import to_json

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.json_reader import read_object
from echoavatar.limits import read_text
from echoavatar.whole_file import write_whole

FILE = "metrics.jsonl"
MOST_BYTES = 1 << 29  # a million lines of a run


class MetricsLog:
    """Writes metrics to the file and to all trackers. `step` is the number of optimiser steps done.

    A value that is not finite is null in the file, since JSON has no word for it.
    """

    def __init__(self, folder: Path, step: int, trackers: Sequence[str] = ()) -> None:
        """Drops lines after `step`, because a resumed run repeats those steps.

        Raises DependencyError if a tracker's package is missing.
        """
        want_trackers(trackers)
        path = folder / FILE
        if path.exists():
            kept = [one for one in read_metrics(path) if one["step"] <= step]
            write_whole(path, "".join(map(_line, kept)))
        self._file = path.open("a", encoding="utf-8")
        openers: dict[str, type[_TensorBoard] | type[_Wandb]] = {"tensorboard": _TensorBoard, "wandb": _Wandb}
        self._trackers = [openers[name](folder) for name in trackers]

    def write(self, step: int, values: Mapping[str, object]) -> None:
        """Log one line."""
        self._file.write(_line({"step": step} | dict(values)))
        self._file.flush()
        for tracker in self._trackers:
            tracker.write(step, values)

    def close(self) -> None:
        """Close the file and all trackers."""
        self._file.close()
        for tracker in self._trackers:
            tracker.close()


def append_metrics(folder: Path, step: int, values: Mapping[str, object]) -> None:
    """Log one line outside of a run."""
    with (folder / FILE).open("a", encoding="utf-8") as file:
        file.write(_line({"step": step} | dict(values)))


def _line(values: Mapping[str, object]) -> str:
    return to_json(values, inf_nan_mode="null").decode() + "\n"


def want_trackers(trackers: Sequence[str]) -> None:
    """Called before long work that ends in training. Raises DependencyError if a tracker's package is missing."""
    for name in trackers:
        if importlib.util.find_spec(name) is None:
            raise DependencyError(f"--track {name} needs the package {name}; run: pip install {name}")


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """The lines of a `metrics.jsonl`, without one that was cut off when the run was killed.

    Raises EchoAvatarError if there is no such file, or it cannot be read.
    """
    found = []
    for line in read_text(path, "give the folder of a run", largest=MOST_BYTES).splitlines():
        with suppress(EchoAvatarError):
            told = read_object(line, FILE)
            found += [told] if isinstance(told.get("step"), int | float) else []
    return found


class _TensorBoard:
    def __init__(self, folder: Path) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer: Any = SummaryWriter(folder / "tensorboard")

    def write(self, step: int, values: Mapping[str, object]) -> None:
        for name, value in values.items():
            if isinstance(value, int | float):
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        self._writer.close()


class _Wandb:
    def __init__(self, folder: Path) -> None:
        import wandb

        mark = folder / "wandb-run"  # a resumed run continues the same W&B run
        name = mark.read_text(encoding="utf-8").strip() if mark.exists() else None
        self._run: Any = wandb.init(project="echoavatar", name=folder.name, id=name, resume="allow", dir=folder)
        write_whole(mark, f"{self._run.id}\n")

    def write(self, step: int, values: Mapping[str, object]) -> None:
        self._run.log(dict(values), step=step)

    def close(self) -> None:
        self._run.finish()
