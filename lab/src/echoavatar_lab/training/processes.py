"""One process or several that share every batch: wraps modules and gathers tensors.

`torchrun` and `accelerate launch` start several processes and set WORLD_SIZE; accelerate (extra `train`) then finds the
devices and wraps the modules for DDP. With `sharded` each process holds only its share of the weights (FSDP2: torch's
`fully_shard`, block by block). Accelerate supports that on GPUs only, so we call it directly, which works on CPUs too.
"""

import atexit
import gc
import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import torch
from torch import Tensor, nn
from torch.distributed.tensor import DTensor, distribute_tensor

from echoavatar.errors import DependencyError, EchoAvatarError


class Processes:
    """A single process; `DistributedProcesses` is the subclass for more."""

    count = 1
    rank = 0

    def __init__(self, device: str = "cpu") -> None:
        self.device = torch.device(device)

    @property
    def is_first(self) -> bool:
        """Whether this is the process that writes."""
        return self.rank == 0

    def wrap(self, module: nn.Module, *, has_idle: bool = False) -> nn.Module:
        """Move the module to the device and wrap it for training; `has_idle`: parts may get no gradient in a step."""
        return module.to(self.device)

    def without_reduction(self, module: nn.Module) -> AbstractContextManager[Any]:
        """Context in which gradients are not yet reduced; the last piece reduces their sum."""
        return nullcontext()

    def gather(self, tensor: Tensor) -> Tensor:
        """The rows of all processes, in order of rank."""
        return tensor

    def gather_json(self, value: Any) -> list[Any]:
        """A small JSON value of each process, in order of rank."""
        return [value]

    def agree(self, is_so: bool) -> bool:
        """Whether the claim holds in any process; each has its own clock and receives its own signals."""
        return is_so

    def wait(self) -> None:
        """Block until all processes have arrived."""


class DistributedProcesses(Processes):
    """One of several processes of a run."""

    def __init__(self, device: str = "cpu", *, sharded: bool = False) -> None:
        """Raises DependencyError when accelerate is missing."""
        try:
            from accelerate import Accelerator
            from accelerate.utils import DistributedDataParallelKwargs
        except ImportError as error:
            raise DependencyError(
                "training in several processes needs accelerate; run: pip install 'echoavatar-lab[train]'"
            ) from error
        self._how = DistributedDataParallelKwargs()
        self._accelerator = Accelerator(cpu=device == "cpu", kwargs_handlers=[self._how])
        self.count, self.rank = self._accelerator.num_processes, self._accelerator.process_index
        self.device = self._accelerator.device
        self.sharded = sharded
        atexit.register(_leave_group)

    def wrap(self, module: nn.Module, *, has_idle: bool = False) -> nn.Module:
        """See `Processes.wrap`."""
        module.to(self.device)
        if not self.sharded:
            self._how.find_unused_parameters = has_idle
            wrapped: nn.Module = self._accelerator.prepare_model(module)
            return wrapped
        from torch.distributed.device_mesh import init_device_mesh
        from torch.distributed.fsdp import fully_shard

        mesh = init_device_mesh(self.device.type, (self.count,))
        for part in list(module.modules()):
            if isinstance(part, nn.ModuleList):
                for block in part:
                    if next(block.parameters(), None) is not None:
                        fully_shard(block, mesh=mesh)
        fully_shard(module, mesh=mesh)
        return module

    def without_reduction(self, module: nn.Module) -> AbstractContextManager[Any]:
        """See `Processes.without_reduction`. Sharded gradients are reduced after every piece; the sum is the same."""
        if self.sharded:
            return nullcontext()
        held: AbstractContextManager[Any] = self._accelerator.no_sync(module)
        return held

    def gather(self, tensor: Tensor) -> Tensor:
        """See `Processes.gather`; every process must contribute the same number of rows."""
        gathered: Tensor = self._accelerator.gather(tensor.to(self.device).contiguous())
        return gathered

    def gather_json(self, value: Any) -> list[Any]:
        """See `Processes.gather_json`."""
        found: list[Any] = [None] * self.count
        torch.distributed.all_gather_object(found, value)
        return found

    def agree(self, is_so: bool) -> bool:
        """See `Processes.agree`."""
        return bool(self.gather(torch.tensor([is_so], dtype=torch.uint8)).any())

    def wait(self) -> None:
        """See `Processes.wait`."""
        self._accelerator.wait_for_everyone()


def _leave_group() -> None:
    """Leave the process group at exit; its threads would abort the program if they outlived the interpreter.

    The group ends its threads when nothing refers to it, so wrapped modules that wait in cycles are freed before.
    """
    if torch.distributed.is_initialized():
        gc.collect()
        torch.distributed.destroy_process_group()


def processes_here(device: str = "cpu", *, sharded: bool = False) -> Processes:
    """The processes that this program was started with."""
    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        return DistributedProcesses(device, sharded=sharded)
    if sharded:
        raise EchoAvatarError("sharding is for several processes; start them with torchrun or accelerate launch")
    return Processes(device)


def full_tensor(tensor: Tensor) -> Tensor:
    """The full tensor without gradient; for a sharded one all processes must call this."""
    full: Tensor = tensor.full_tensor() if isinstance(tensor, DTensor) else tensor
    return full.detach()


def placed_like(value: Tensor, like: Tensor) -> Tensor:
    """A full tensor, sharded and placed like another one."""
    if isinstance(like, DTensor):
        placed: Tensor = distribute_tensor(value.to(like.device), like.device_mesh, like.placements, src_data_rank=None)
        return placed
    return value.to(like.device)


@contextmanager
def full_state_dicts(modules: Mapping[str, nn.Module]) -> Iterator[None]:
    """Context in which state dicts hold full tensors instead of shards; all processes must enter it."""
    full = {
        name: {key: full_tensor(p) for key, p in module.named_parameters() if isinstance(p, DTensor)}
        for name, module in modules.items()
    }

    def shown(name: str) -> Any:
        def hook(module: nn.Module, state: dict[str, Any], prefix: str, metadata: Any) -> None:
            state.update({prefix + key: value for key, value in full[name].items() if prefix + key in state})

        return hook

    handles = [modules[name].register_state_dict_post_hook(shown(name)) for name in full if full[name]]  # type: ignore[no-untyped-call]
    try:
        yield
    finally:
        for handle in handles:
            handle.remove()
