"""`echoavatar doctor`: what works on this machine, and what to do about the rest."""

import argparse
import importlib
import importlib.util
import os
import platform
import shutil
import sys
from collections.abc import Callable
from ctypes.util import find_library

from ..errors import EchoAvatarError

OK, OPTIONAL, BROKEN = "ok", "--", "!!"
Finding = tuple[str, str, str]  # mark, what, remark


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """No arguments: it only looks."""
    parser.epilog = (
        "ok works; -- optional and absent; !! needed and broken. Exits 1 when something needed is broken."
    )


def run(args: argparse.Namespace) -> int:
    """Print a line for each thing looked at."""
    del args
    checks: list[Callable[[], list[Finding]]] = [_python, _torch, _forbidden, _extras, _programs, _bundle]
    findings = [finding for check in checks for finding in check()]
    for mark, what, remark in findings:
        print(f"{mark}  {what:<22} {remark}")
    broken = sum(mark == BROKEN for mark, _, _ in findings)
    print(f"{broken} of {len(findings)} need attention" if broken else "everything that is needed works")
    return 1 if broken else 0


def _python() -> list[Finding]:
    version = platform.python_version()
    mark = OK if sys.version_info >= (3, 11) else BROKEN
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return [
        (mark, "python", version if mark == OK else f"{version}; needs 3.11 or newer"),
        (OK, "cores", str(cores)),
    ]


def _torch() -> list[Finding]:
    try:
        torch = importlib.import_module("torch")
    except (ImportError, OSError) as error:
        return [(BROKEN, "torch", f"does not load ({error}); pip install torch==2.13.0")]
    gpu = (
        torch.cuda.get_device_name()
        if torch.cuda.is_available()
        else "none; the default bundle runs on the CPU"
    )
    return [(OK, "torch", torch.__version__), (OK if torch.cuda.is_available() else OPTIONAL, "gpu", gpu)]


def _forbidden() -> list[Finding]:
    found = [name for name in ("torchaudio", "torchvision", "torchao") if importlib.util.find_spec(name)]
    return [(BROKEN, name, f"breaks on CPU torch and is not needed; pip uninstall {name}") for name in found]


def _extras() -> list[Finding]:
    wanted = {
        "PIL": ("render", "MP4 with the shaded character, pictures and contact sheets"),
        "librosa": ("evaluate", "beat alignment scores"),
        "pretty_midi": ("rehearse", "music rendered with a soundfont"),
    }
    rows = []
    for name, (extra, use) in wanted.items():
        there = importlib.util.find_spec(name) is not None
        remark = use if there else f"absent, for {use}; pip install 'echoavatar[{extra}]'"
        rows.append((OK if there else OPTIONAL, name, remark))
    return rows


def _programs() -> list[Finding]:
    flite = find_library("flite") is not None
    fluid = shutil.which("fluidsynth") is not None
    return [
        (
            OK if flite else OPTIONAL,
            "flite",
            "speech for the corpus" if flite else "absent; our own voice is used instead",
        ),
        (
            OK if fluid else OPTIONAL,
            "fluidsynth",
            "music for the corpus" if fluid else "absent; our own synthesiser is used",
        ),
    ]


def _bundle() -> list[Finding]:
    from ..pipeline import load_bundle

    try:
        bundle = load_bundle("default")
    except EchoAvatarError as error:
        return [(BROKEN, "default bundle", str(error))]
    return [(OK, "default bundle", f"loads; {bundle.parameters / 1e6:.1f} M parameters")]
