"""`echoavatar doctor`: says what works on this machine, and how to repair the rest.

It reports only what it tried: it imports every module, and makes and writes one second of motion.
"""

import argparse
import importlib
import importlib.util
import os
import pkgutil
import platform
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable
from ctypes.util import find_library
from pathlib import Path

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.nn.torch_backend import torch_backend

from . import SEPARATE

OK, OPTIONAL, BROKEN = "ok", "--", "!!"
EXAMPLES = "ok: works. --: optional, and absent. !!: needed, and broken; the exit code is then 1."
Finding = tuple[str, str, str]  # mark, what, remark
EXTRA_OF = {  # packages that come with an extra, by the name they are imported under
    "DracoPy": "gltf",
    "aiortc": "video",
    "anyio": "serve",
    "elevenlabs": "elevenlabs",
    "huggingface_hub": "hub",
    "mcp": "mcp",
    "mcp_types": "mcp",
    "meshopt": "gltf",
    "moderngl": "gpu",
    "msgspec": "serve",
    "opentelemetry": "traces",
    "prometheus_client": "serve",
    "pxr": "usd",
    "pyvirtualcam": "camera",
    "ray": "ray",
    "shtab": "completion",
    "starlette": "serve",
    "uvicorn": "serve",
    "websockets": "serve",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """This command has no arguments."""


def run(args: argparse.Namespace) -> int:
    """Print one line for each finding."""
    del args
    checks: list[Callable[[], list[Finding]]] = [_python, _torch, _forbidden, _modules, _extras, _separate, _motion]
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
    return [(mark, "python", version if mark == OK else f"{version}; needs 3.11 or newer"), (OK, "cores", str(cores))]


def _torch() -> list[Finding]:
    try:
        version, gpu = torch_backend("a GPU").describe()
    except DependencyError:
        remark = "absent, for GPUs, models of the paper's sizes and imported ones; pip install ./lab in a clone"
        return [(OPTIONAL, "torch", remark)]
    except (ImportError, OSError) as error:
        return [(BROKEN, "torch", f"does not load ({error}); pip install torch==2.13.0")]
    gpu_found = (OK, "gpu", gpu) if gpu else (OPTIONAL, "gpu", "none; the default bundle runs on the CPU")
    return [(OK, "torch", version), gpu_found]


def _forbidden() -> list[Finding]:
    found = [name for name in ("torchaudio", "torchvision", "torchao") if importlib.util.find_spec(name)]
    return [(BROKEN, name, f"breaks on CPU torch and is not needed; pip uninstall {name}") for name in found]


def _modules() -> list[Finding]:
    """Import every module of the package, as its commands would."""
    import echoavatar

    loaded, failed = 0, dict[tuple[str, str, str], None]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for module in pkgutil.walk_packages(echoavatar.__path__, "echoavatar.", onerror=lambda name: None):
            if module.name.endswith(".__main__"):
                continue
            try:
                importlib.import_module(module.name)
                loaded += 1
            except Exception as error:  # a module may fail in any way on a machine that does not suit it
                failed[_failure(module.name, error)] = None
    return [(OK, "modules", f"{loaded} load"), *failed]


def missing_package(error: ModuleNotFoundError) -> tuple[str, str] | None:
    """The absent package and the command that installs it; None for a package that is always installed."""
    name = (error.name or "").partition(".")[0]
    if name == "echoavatar_lab":
        return "echoavatar-lab", "pip install ./lab in a clone of the repository"
    return (name, f"pip install 'echoavatar[{EXTRA_OF[name]}]'") if name in EXTRA_OF else None


def _failure(module: str, error: Exception) -> Finding:
    """The finding for a module that does not load: a fault, unless a package of an extra is absent."""
    room = module.split(".")[1]
    if isinstance(error, ModuleNotFoundError) and (missing := missing_package(error)):
        return OPTIONAL, room, f"needs {missing[0]}; {missing[1]}"
    if isinstance(error, DependencyError):
        return OPTIONAL, room, str(error)
    return BROKEN, room, f"{module} does not load ({_said(error)}); install the package again"


def _extras() -> list[Finding]:
    uses = {"huggingface_hub": "models from the hub", "pxr": "USD files"}
    rows = []
    for name, use in uses.items():
        is_there = importlib.util.find_spec(name) is not None
        remark = use if is_there else f"absent, for {use}; pip install 'echoavatar[{EXTRA_OF[name]}]'"
        rows.append((OK if is_there else OPTIONAL, name, remark))
    return rows


def _separate() -> list[Finding]:
    """The distributions beside this one, what they add, and the programs that the lab uses."""
    rows, there = [], {name: importlib.util.find_spec(f"echoavatar_{name}") is not None for name in ("lab", "studio")}
    for name, is_there in there.items():
        added = ", ".join(f"`{command}`" for command, home in SEPARATE.items() if home == name)
        remark = added if is_there else f"absent, for {added}; pip install ./{name} in a clone of the repository"
        rows.append((OK if is_there else OPTIONAL, f"echoavatar-{name}", remark))
    if there["lab"]:
        has_fluidsynth = shutil.which("fluidsynth") is not None
        try:
            has_flite = find_library("flite") is not None
        except OSError:  # it may need a temporary file
            has_flite = False
        speech = "speech for the corpus" if has_flite else "absent; our own voice is used instead"
        music = "music for the corpus" if has_fluidsynth else "absent; our own synthesiser is used"
        rows += [(OK if has_flite else OPTIONAL, "flite", speech)]
        rows += [(OK if has_fluidsynth else OPTIONAL, "fluidsynth", music)]
    return rows


def _motion() -> list[Finding]:
    """Load the default bundle, make one second of motion, and write it: what `animate` does."""
    import numpy as np

    what = "default bundle"
    try:
        from echoavatar.animation import Animation, animate
        from echoavatar.engine.pipeline import load_bundle
        from echoavatar.timing import SAMPLE_RATE_HZ

        bundle = load_bundle("default")
        found = [(OK, what, f"loads; {bundle.parameters / 1e6:.1f} M parameters")]
        what = "motion"
        done = animate(0.1 * np.sin(np.arange(SAMPLE_RATE_HZ) / 20).astype(np.float32))
        found.append((OK, what, f"one second made in {done.work_s:.2f} s"))
        try:
            tempfile.gettempdir()
        except OSError:
            return [*found, (OPTIONAL, "files", "not tried: no folder for temporary files; set TMPDIR to one")]
        with tempfile.TemporaryDirectory() as folder:
            for suffix in (".glb", ".bvh", ".npz", ".csv", ".vrma"):
                what, path = suffix, Path(folder) / f"motion{suffix}"
                done.save(path)
            what, film = ".mp4", Animation(done.motion.cut(0, 3), done.audio, done.work_s)
            film.save(Path(folder) / "motion.mp4", size=(160, 90))
        return [*found, (OK, "files", "GLB, BVH, NPZ, CSV, VRMA and MP4 are written")]
    except EchoAvatarError as error:
        return [(BROKEN, what, str(error))]
    except Exception as error:  # the point is to find out whether `animate` would end in a traceback
        return [(BROKEN, what, f"fails ({_said(error)}); install the package again in a fresh environment")]


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:160]}"
