"""Where models run: on the CPU, in a number of threads, or on a GPU, which needs echoavatar-lab."""

import os

from echoavatar.errors import DependencyError, EchoAvatarError

from .torch_backend import torch_backend


def find_device(name: str) -> str:
    """The device of this name: `cpu`, `cuda`, one GPU such as `cuda:1`, or `auto`: the GPU where there is one.

    Raises EchoAvatarError: there is no such device here. DependencyError: a GPU is named without echoavatar-lab.
    """
    if name == "cpu":
        return name
    kind, _, number = name.partition(":")
    if name not in ("auto", "cuda") and (kind != "cuda" or not number.isdecimal()):
        raise EchoAvatarError(f"no device {name!r}; say cpu, cuda, cuda:1 or auto")
    try:
        found, why_none = torch_backend("a GPU").devices()
    except DependencyError:
        if name == "auto":
            return "cpu"
        raise
    if name == "auto":
        return "cuda" if found else "cpu"
    if int(number or 0) >= found:
        why = f"there are {found} here" if found else why_none
        raise EchoAvatarError(f"no CUDA device {number or 0}: {why}; --device cpu runs everywhere")
    return name


def threads() -> int:
    """How many threads may compute: $OMP_NUM_THREADS, else the processors that this process may use."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdecimal() and int(asked):
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
