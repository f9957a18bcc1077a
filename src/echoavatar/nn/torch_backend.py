"""The one import of echoavatar-lab, which has all torch modules: for GPUs, and for models without graph or kernel."""

from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from echoavatar.errors import DependencyError

_HOME = "echoavatar_lab.torch_backend"


class TorchBackend(Protocol):
    """What the lab's module `torch_backend` offers."""

    def load_part(self, name: str, folder: Path) -> Any:
        """The torch module of a part: `codec`, `tokenizer`, `generator` or `face`. CheckpointError if damaged."""

    def open_step(self, module: Any, device: str, step: str, init_state: str) -> Any:
        """A module's step on a device, with `init_state(rows)` and `step(x, state, active)` of arrays."""

    def open_generator(self, module: Any, device: str, precision: str) -> Any:
        """As `open_step`, for a generator, whose weights may be rounded (`precision`)."""

    def random_generator(self, config: Any) -> Any:
        """A generator of random weights."""

    def devices(self) -> tuple[int, str]:
        """The number of GPUs and, if it is 0, the reason."""

    def describe(self) -> tuple[str, str]:
        """The version of torch, and the name of the GPU or nothing."""

    def synchronize(self) -> None:
        """Wait until the GPU has done its work."""


def torch_backend(what: str) -> TorchBackend:
    """The lab's modules of torch, which `what` needs. Raises DependencyError without the lab."""
    try:
        return cast("TorchBackend", import_module(_HOME))
    except ModuleNotFoundError as error:
        if error.name not in (_HOME, _HOME.partition(".")[0], "torch"):
            raise
        raise DependencyError(
            f"{what} needs torch, which comes with echoavatar-lab; in a clone of the repository: pip install ./lab"
        ) from error
