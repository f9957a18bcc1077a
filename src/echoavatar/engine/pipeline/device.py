"""Choose the processor that runs the models, from the value of `--device`."""

import torch

from echoavatar.errors import EchoAvatarError


def find_device(name: str) -> torch.device:
    """`cpu`, `cuda`, a certain one such as `cuda:1`, or `auto`: the GPU where there is one.

    Raises:
        EchoAvatarError: there is no such device here.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    kind, _, number = name.partition(":")
    if kind == "cpu" and not number:
        return torch.device("cpu")
    if kind != "cuda" or (number and not number.isdecimal()):
        raise EchoAvatarError(f"no device {name!r}; say cpu, cuda, cuda:1 or auto")
    found = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if int(number or 0) >= found:
        why = f"there are {found} here" if found else _why_none()
        raise EchoAvatarError(f"no CUDA device {number or 0}: {why}; --device cpu runs everywhere")
    return torch.device(name)


def _why_none() -> str:
    if torch.version.cuda is None:
        return "this is torch's CPU build (pip install torch from the index of a CUDA build)"
    return "no GPU, or no driver for it (see nvidia-smi)"
