"""`echoavatar bench start`: how long a fresh process takes until an avatar can answer, stage by stage.

Every run is a process of its own, as a user's would be. The first may compile loops and read the disk; the median of
the others is the warm start.
"""

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

_STAGES = """
import sys, time
began, marks = time.perf_counter(), {}
def mark(name):
    global began
    now = time.perf_counter()
    marks[name], began = now - began, now
import numpy, torch
mark("torch")
import echoavatar.engine, echoavatar.files.exports
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.nn.kernels import compilations
mark("imports")
pipeline = Pipeline(load_bundle(sys.argv[1]))
mark("load")
with compilations() as compiled:
    pipeline.warm_up()
mark("warm-up")
echoavatar.engine.animate(pipeline, [numpy.zeros(5 * 24_000, numpy.float32)])
mark("motion")
import json
print(json.dumps([marks, len(compiled)]))
"""


class StartReport(NamedTuple):
    """Seconds of the stages, one entry per run; `motion` is for five seconds of sound."""

    stages: dict[str, list[float]]
    wall: list[float]  # from the start of the process to its end
    help: list[float]  # `echoavatar --help`
    compiled: list[int]  # loops that were compiled

    @property
    def summary(self) -> dict[str, float]:
        """Medians of the runs after the first, in seconds."""
        rows = self.stages | {"wall": self.wall, "help": self.help}
        return {f"{name}_s": round(statistics.median(values[1:]), 3) for name, values in rows.items()}


def bench_start(model: str, *, runs: int = 4, progress: Callable[[int], None] = lambda _: None) -> StartReport:
    """Start `runs` processes one after another (two or more) and time them.

    Raises:
        ValueError: fewer than two runs.
        RuntimeError: a process failed.
    """
    if runs < 2:
        raise ValueError(f"{runs} runs do not show a warm start; ask for two or more")
    report = StartReport({}, [], [], [])
    for run in range(runs):
        said, wall = _timed([sys.executable, "-c", _STAGES, model])
        marks, compiled = json.loads(said.splitlines()[-1])
        for name, seconds in marks.items():
            report.stages.setdefault(name, []).append(seconds)
        report.wall.append(wall)
        report.compiled.append(compiled)
        report.help.append(_timed([sys.executable, "-m", "echoavatar", "--help"])[1])
        progress(run + 1)
    return report


def _timed(command: list[str]) -> tuple[str, float]:
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr else f"{command[0]} failed")
    return done.stdout, time.perf_counter() - began
