"""Where models run: on the processor, in so many threads, or on a GPU. Torch is loaded where somebody asks for it."""

import os
from importlib import import_module
from typing import Any

from echoavatar.errors import DependencyError, EchoAvatarError


def need_torch(what: str) -> Any:
    """Torch, which `what` needs. Raises DependencyError if it is not installed."""
    try:
        return import_module("torch")
    except ModuleNotFoundError as error:
        raise DependencyError(f'{what} needs torch: pip install "echoavatar[torch]"') from error


def find_device(name: str) -> str:
    """The device that is meant: `cpu`, `cuda`, a certain one such as `cuda:1`, or `auto`: the GPU where there is one.

    Raises EchoAvatarError if there is no such device here, DependencyError if a GPU is asked for without torch.
    """
    if name == "cpu":
        return name
    kind, _, number = name.partition(":")
    if name != "auto" and (kind != "cuda" or (number and not number.isdecimal())):
        raise EchoAvatarError(f"no device {name!r}; say cpu, cuda, cuda:1 or auto")
    try:
        torch = need_torch("a GPU")
    except DependencyError:
        if name == "auto":
            return "cpu"
        raise
    found = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if name == "auto":
        return "cuda" if found else "cpu"
    if int(number or 0) >= found:
        why = f"there are {found} here" if found else _why_none(torch)
        raise EchoAvatarError(f"no CUDA device {number or 0}: {why}; --device cpu runs everywhere")
    return name


def threads() -> int:
    """How many threads may compute: $OMP_NUM_THREADS, else the processors that this process may use."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdecimal() and int(asked):
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _why_none(torch: Any) -> str:
    if torch.version.cuda is None:
        return "this is torch's CPU build (pip install torch from the index of a CUDA build)"
    return "no GPU, or no driver for it (see nvidia-smi)"
