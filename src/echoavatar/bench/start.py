"""`echoavatar bench start`: how long a fresh process takes until an avatar can answer, phase by phase.

Every run is two processes: one that times its phases, and `echoavatar animate` as a user runs it. The first run may
compile loops and read the disk; the median of the others is the warm start.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import write_wav
from echoavatar.timing import SAMPLE_RATE_HZ

_PHASES = """
import sys, time
began, marks = time.perf_counter(), {}
def mark(name):
    global began
    now = time.perf_counter()
    marks[name], began = now - began, now
import numpy
mark("numpy")
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
    """Seconds of the phases, one entry per run; `motion` is for five seconds of sound."""

    phases: dict[str, list[float]]
    animate: list[float]  # `echoavatar animate five_seconds.wav -o five_seconds.glb`, from command to prompt
    help: list[float]  # `echoavatar --help`
    compiled: list[int]  # loops that were compiled

    @property
    def summary(self) -> dict[str, float]:
        """Medians of the runs after the first, in seconds."""
        rows = self.phases | {"animate": self.animate, "help": self.help}
        return {f"{name}_s": round(statistics.median(values[1:]), 3) for name, values in rows.items()}


def bench_start(model: str, *, runs: int = 4, progress: Callable[[int], None] = lambda _: None) -> StartReport:
    """Start `runs` processes one after another (two or more) and time them.

    Raises:
        EchoAvatarError: fewer than two runs.
        RuntimeError: a process failed.
    """
    if runs < 2:
        raise EchoAvatarError("--runs needs two or more: the first run is not a warm start")
    report = StartReport({}, [], [], [])
    with tempfile.TemporaryDirectory() as folder:
        sound = Path(folder) / "five_seconds.wav"
        write_wav(sound, np.zeros(5 * SAMPLE_RATE_HZ, np.float32))
        command = ["animate", str(sound), "-o", str(sound.with_suffix(".glb")), "--model", model]
        for run in range(runs):
            said, _ = _timed(["-c", _PHASES, model])
            marks, compiled = json.loads(said.splitlines()[-1])
            for name, seconds in marks.items():
                report.phases.setdefault(name, []).append(seconds)
            report.compiled.append(compiled)
            report.animate.append(_timed(["-m", "echoavatar", *command])[1])
            report.help.append(_timed(["-m", "echoavatar", "--help"])[1])
            progress(run + 1)
    return report


def _timed(words: list[str]) -> tuple[str, float]:
    began = time.perf_counter()
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr else "the process failed")
    return done.stdout, time.perf_counter() - began
