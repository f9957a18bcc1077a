"""A newcomer's first minutes: from the clone to a moving picture, in a folder that held nothing.

    python scripts/newcomer.py                    # clones this checkout's last commit; installs from PyPI alone
    python scripts/newcomer.py --work FOLDER      # an empty folder, kept afterwards

Each step runs as a person would type it, with a home of its own, no caches of pip or numba, and nothing of this
environment but the network's settings. The table gives minutes, the gigabytes that a step left on the disk and how many
warnings it printed; every warning follows in its own words. Exits with 1 if a step fails or the picture stands still.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
WARNING = re.compile(r"warn|deprecat|retry|error|could not|not found", re.IGNORECASE)
# What a newcomer does not have.
OWN = (
    "PYTHON",
    "VIRTUAL_ENV",
    "NUMBA",
    "XDG_",
    "ECHOAVATAR",
    "PIP_FIND_LINKS",
    "PIP_EXTRA_INDEX_URL",
    "PIP_CONSTRAINT",
)
START_S = 600.0  # of a server that compiles first
STILL = 0.5  # of 255: a mean change between two pictures under which nothing moved
MOVES = """
import sys, av, numpy as np
pictures = [frame.to_ndarray(format="gray").astype(float) for frame in av.open(sys.argv[1]).decode(video=0)]
print(len(pictures), "pictures; the mean change over a second is", round(float(np.mean(
    [np.abs(now - later).mean() for now, later in zip(pictures[::30], pictures[30::30])])), 2), "of 255")
"""


class Step(NamedTuple):
    """What a newcomer waited for: seconds, bytes that it left on the disk, the lines it printed that warn."""

    name: str
    seconds: float
    size: int
    warnings: list[str]


def main() -> int:
    """Run the steps and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, help="an empty folder, kept afterwards (default: a temporary one)")
    parser.add_argument("--source", default=ROOT.as_uri(), help="the repository to clone (default: %(default)s)")
    args = parser.parse_args()
    if args.work is not None and args.work.exists() and any(args.work.iterdir()):
        parser.error(f"{args.work} is not empty; name a new folder")
    with tempfile.TemporaryDirectory() as temporary:
        newcomer = Newcomer((args.work or Path(temporary)).resolve())
        newcomer.visit(args.source)
        return newcomer.report()


class Newcomer:
    """A person in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.steps, self.failure = folder, list[Step](), ""
        home = folder / "home"
        home.mkdir(parents=True)
        kept = {name: value for name, value in os.environ.items() if not name.startswith(OWN)}
        self.environment = kept | {"HOME": str(home), "USERPROFILE": str(home), "PIP_CACHE_DIR": str(home / "pip")}
        self.environment |= {"PIP_CONFIG_FILE": os.devnull}

    def visit(self, source: str) -> None:
        """Do all of it, up to the first step that fails."""
        clone, programs = self.folder / "echoavatar", self.folder / "env" / ("Scripts" if os.name == "nt" else "bin")
        film = self.folder / "talk.mp4"
        sound = clone / "src/echoavatar/assets/speech.ogg"
        python, command = programs / "python", programs / "echoavatar"
        steps: list[tuple[str, list[object]]] = [
            ("clone", ["git", "clone", "--depth", "1", source, clone]),
            ("virtual environment", [sys.executable, "-m", "venv", self.folder / "env"]),
            ("pip install", [python, "-m", "pip", "install", f"{clone}[serve]"]),
            ("a film of speech", [command, "animate", sound, "-o", film, "--seed", "1"]),
            ("does it move?", [python, "-c", MOVES, film]),
            ("the same, again", [command, "animate", sound, "-o", film, "--seed", "1"]),
        ]
        for name, words in steps:
            if not self.do(name, words):
                return
        self.serve(command)

    def do(self, name: str, words: list[object]) -> bool:
        """A command that ends; false if it failed."""
        typed = " ".join(str(word) for word in words if word != MOVES)
        print(f"$ {typed}", flush=True)
        began, before = time.monotonic(), size_of(self.folder)
        with self.started(words) as process:
            output = process.communicate()[0]
        self.note(name, time.monotonic() - began, before, output)
        if change := re.search(r".*is ([\d.]+) of 255", output):
            print(change[0])
        if process.returncode or (change and float(change[1]) < STILL):
            self.failure = f"{name}: {output.strip()[-1500:]}"
        return not self.failure

    def serve(self, command: Path) -> None:
        """The live page: until `say` has got motion for a sound from it."""
        print("$ echoavatar serve", flush=True)
        began, before, said = time.monotonic(), size_of(self.folder), list[str]()
        with self.started([command, "serve", "--port", "0"]) as process:
            assert process.stdout is not None
            stopping = threading.Timer(START_S, process.terminate)
            stopping.start()
            try:
                address = ""
                while not address and (line := process.stdout.readline()):
                    said.append(line)
                    address = next(iter(re.findall(r"http://[\w.:]+", line)), "")
                sound = self.folder / "echoavatar/src/echoavatar/assets/speech.ogg"
                answer = subprocess.run(
                    [command, "say", sound, "--server", address, "-o", self.folder / "said.npz"],
                    env=self.environment,
                    capture_output=True,
                    text=True,
                )
            finally:
                stopping.cancel()
                process.terminate()
                said += process.stdout.readlines()
        self.note("serve, until it moved", time.monotonic() - began, before, "".join(said) + answer.stderr)
        if answer.returncode:
            self.failure = f"serve: {(''.join(said) + answer.stderr)[-1500:]}"

    def started(self, words: list[object]) -> "subprocess.Popen[str]":
        """A command that runs, its output in one pipe."""
        return subprocess.Popen(
            [str(word) for word in words],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )

    def note(self, name: str, seconds: float, before: int, output: str) -> None:
        """Remember what a step took, and what it warned of."""
        warnings = list(dict.fromkeys(line.strip() for line in output.splitlines() if WARNING.search(line)))
        self.steps.append(Step(name, seconds, size_of(self.folder) - before, warnings))

    def report(self) -> int:
        """Print the table; returns the exit code."""
        print("\n| step | minutes | GB | warnings |\n|---|---|---|---|")
        for step in self.steps:
            print(f"| {step.name} | {step.seconds / 60:.1f} | {step.size / 1e9:.2f} | {len(step.warnings)} |")
        seconds, size = sum(step.seconds for step in self.steps), sum(step.size for step in self.steps)
        print(f"| all | {seconds / 60:.1f} | {size / 1e9:.2f} | {sum(len(step.warnings) for step in self.steps)} |\n")
        for name in ("echoavatar", "env", "home"):
            print(f"{name}: {size_of(self.folder / name) / 1e9:.2f} GB")
        for step in self.steps:
            for line in step.warnings:
                print(f"{step.name}: {line[:300]}")
        if self.failure:
            print(f"FAILED {self.failure}")
        return 1 if self.failure else 0


def size_of(folder: Path) -> int:
    """Bytes of all files in a folder."""
    if not folder.exists():
        return 0
    done = subprocess.run(["du", "-sk", folder], capture_output=True, text=True) if shutil.which("du") else None
    if done and done.stdout:
        return int(done.stdout.split()[0]) * 1024
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink())


if __name__ == "__main__":
    sys.exit(main())
