"""Modules of torch and their checkpoints. Loading is strict and says what is wrong.

No module is built that is larger than the weights stored for it. Uses `echoavatar` only.
"""

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn.modules.module import register_module_parameter_registration_hook
from torch.overrides import TorchFunctionMode

from echoavatar.config import Config
from echoavatar.errors import CheckpointError
from echoavatar.stored import SCALE, WEIGHTS, ConfigT, Rounded, check_shapes, read_arrays, read_config, round_to_int8
from echoavatar.whole_file import make_output_folder, whole_file, write_whole

ModuleT = TypeVar("ModuleT", bound=nn.Module)
_DRAWS = {Tensor.normal_, Tensor.uniform_, nn.init.normal_, nn.init.uniform_, nn.init.kaiming_uniform_}


def read_weights(folder: Path) -> dict[str, Tensor]:
    """Read `model.safetensors`; storage in half precision or in int8 (see `save`) becomes float32.

    Raises CheckpointError if the file is missing or damaged.
    """
    arrays = read_arrays(folder)
    return {
        key: torch.from_numpy(value.floats() if isinstance(value, Rounded) else value) for key, value in arrays.items()
    }


def load(folder: Path, kind: type[ConfigT], build: Callable[[ConfigT], ModuleT]) -> ModuleT:
    """The module that `build` makes of a folder's config, with the folder's weights in it.

    Raises CheckpointError if files are missing or damaged, or config and weights do not fit each other.
    """
    config = read_config(folder, kind)
    return build_for(read_weights(folder), lambda: build(config), origin=str(folder))


def build_for(weights: Mapping[str, Tensor], build: Callable[[], ModuleT], *, origin: str) -> ModuleT:
    """The module that `build` makes, with `weights` in it.

    Raises CheckpointError if the module is larger than the weights, or does not fit them.
    """
    try:
        with _no_larger_than(weights), _Unset():
            module = build()
    except (ArithmeticError, MemoryError, RuntimeError, TypeError, ValueError) as error:  # torch: 2^70 is a TypeError
        reason = str(error).split("\n")[0][:160]
        raise CheckpointError(f"{origin}: config.json describes no model of these weights: {reason}") from error
    load_into(module, weights, origin=origin)
    return module


class _Unset(TorchFunctionMode):
    """Leave out the random first values of parameters: `load_into` overwrites every one of them.

    Drawing them takes as long as reading the weights that replace them.
    """

    def __torch_function__(
        self,
        func: Callable[..., object],
        types: object,
        args: tuple[object, ...] = (),
        kwargs: dict[str, object] | None = None,
    ) -> object:
        kwargs = kwargs or {}
        if func in _DRAWS:
            return args[0] if args else kwargs["tensor"]
        return func(*args, **kwargs)


@contextmanager
def _no_larger_than(weights: Mapping[str, Tensor]) -> Iterator[None]:
    """While this thread builds a module, its parameters may not far outgrow the weights in number or in size.

    Twice as many are let through, because a normalised layer registers its weight before it is split in two.
    `load_into` names the weights that do not fit exactly.
    """
    numbers = sum(weight.numel() for weight in weights.values())
    left = {"parameters": 2 * len(weights) + 64, "numbers": 2 * numbers + (1 << 22)}
    thread = threading.get_ident()

    def count(module: nn.Module, name: str, parameter: nn.Parameter | None) -> None:
        if parameter is None or threading.get_ident() != thread:
            return
        left["parameters"] -= 1
        left["numbers"] -= parameter.numel()
        for what, number in left.items():
            if number < 0:
                raise ValueError(f"it asks for more {what} than model.safetensors has")

    hook = register_module_parameter_registration_hook(count)
    try:
        yield
    finally:
        hook.remove()


def load_into(module: nn.Module, weights: Mapping[str, Tensor], *, origin: str) -> None:
    """Strictly load `weights`; every missing, extra and misshapen key is named.

    Raises CheckpointError: keys or shapes differ.
    """
    own, given = ({key: value.shape for key, value in found.items()} for found in (module.state_dict(), weights))
    check_shapes(own, given, origin=origin)
    module.load_state_dict(dict(weights))


def save(
    folder: Path,
    *,
    config: Config,
    weights: Mapping[str, Tensor],
    card: Mapping[str, object],
    dtype: torch.dtype | None = None,
) -> None:
    """Write a checkpoint folder whole or not at all; `dtype` stores floating weights in that precision.

    With `torch.int8` matrices are stored as integers with one scale per row, and vectors in half precision. Raises
    CheckpointError if a file cannot be written.
    """
    make_output_folder(folder, error=CheckpointError)
    stored = {}
    for key, value in weights.items():
        kept = value.detach().cpu()
        if dtype == torch.int8 and kept.is_floating_point() and kept.ndim == 2:
            kept, stored[key + SCALE] = map(torch.from_numpy, round_to_int8(kept.float().numpy()))
        elif dtype is not None and kept.is_floating_point():
            kept = kept.to(torch.float16 if dtype == torch.int8 else dtype)
        stored[key] = kept.contiguous()
    path = folder / WEIGHTS
    with whole_file(path, error=CheckpointError, failures=(SafetensorError,), is_flushed=True) as partial:
        save_file(stored, partial)
    for name, text in (("config", config.model_dump_json(indent=2)), ("card", json.dumps(dict(card), indent=2))):
        write_whole(folder / f"{name}.json", text + "\n", error=CheckpointError, is_flushed=True)


class Checkpointed(nn.Module):
    """A model that is made from its config alone."""

    config_type: ClassVar[type[Config]]
    config: Any  # of `config_type`

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a checkpoint folder; the model is ready for use (eval mode).

        Raises CheckpointError if a file is missing, damaged or of another shape.
        """
        return load(folder, cls.config_type, cls).eval()

    def save(self, folder: Path, card: Mapping[str, object], *, dtype: torch.dtype | None = None) -> None:
        """Write a checkpoint folder, with weights in `dtype` where it is given."""
        save(folder, config=self.config, weights=self.state_dict(), card=card, dtype=dtype)
