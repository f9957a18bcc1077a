"""A checkpoint is a folder: `config.json`, `model.safetensors`, `card.json`. Loading is strict and says what is wrong.

Nothing is ever unpickled, and no module is built that is larger than the weights stored for it. Uses `config`,
`json_reader`, `limits`, `whole_file` and `errors` only.
"""

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import torch
from jaxtyping import Float, Int8
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.nn.modules.module import register_module_parameter_registration_hook
from torch.overrides import TorchFunctionMode

from .config import Config
from .errors import CheckpointError, EchoAvatarError
from .json_reader import read_object_file
from .limits import CONFIG_BYTES, check_file
from .whole_file import make_output_folder, whole_file, write_whole

ConfigT = TypeVar("ConfigT", bound=Config)
ModuleT = TypeVar("ModuleT", bound=nn.Module)
LARGEST_WEIGHTS_BYTES = 1 << 36
_SCALE = ".int8_scale"
_EXACT = 1e-3  # a weight this close to an integer, in steps, is always rounded to it; covers float32 errors
_DRAWS = {Tensor.normal_, Tensor.uniform_, nn.init.normal_, nn.init.uniform_, nn.init.kaiming_uniform_}


def read_config(folder: Path, kind: type[ConfigT], name: str = "config.json") -> ConfigT:
    """Read and check the settings of a folder.

    Raises CheckpointError if the folder or file is missing, or a field does not fit.
    """
    path = folder / name
    try:
        return kind.model_validate(read_object_file(path))
    except FileNotFoundError as error:
        raise CheckpointError(f"{folder} is not a checkpoint: {name} is missing") from error
    except EchoAvatarError as error:
        raise CheckpointError(f"{error}; copy or download it again") from error
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise CheckpointError(f"{path}: {field}: {first['msg']}; copy or download it again") from error


def read_card(folder: Path) -> dict[str, object]:
    """The model card (data, command, scores, licence), or an empty one where there is none."""
    path = folder / "card.json"
    try:
        return read_object_file(path)
    except FileNotFoundError:
        return {}
    except EchoAvatarError as error:
        raise CheckpointError(f"{error}; copy or download it again") from error


def check_weights(path: Path) -> None:
    """Refuse a safetensors file that is no regular file, too large, or lists more tensors than any model has.

    Raises:
        FileNotFoundError: there is nothing; the caller knows the remedy.
        CheckpointError: it is refused.
    """
    check_file(path, LARGEST_WEIGHTS_BYTES, CheckpointError)
    with path.open("rb") as file:
        header = int.from_bytes(file.read(8), "little")
    if header > CONFIG_BYTES:
        raise CheckpointError(f"{path} is damaged (a list of tensors of {header:,} bytes); copy or download it again")


def read_weights(folder: Path) -> dict[str, Tensor]:
    """Read `model.safetensors`; storage in half precision or in int8 (see `save`) becomes float32."""
    path = folder / "model.safetensors"
    try:
        check_weights(path)
        weights = load_file(path)
    except FileNotFoundError as error:
        raise CheckpointError(f"{folder} is not a checkpoint: model.safetensors is missing") from error
    except SafetensorError as error:
        raise CheckpointError(f"{path} is damaged ({error}); copy or download it again") from error
    half = (torch.float16, torch.bfloat16)
    for key in [key for key in weights if key.endswith(_SCALE)]:
        scale, rounded = weights.pop(key), weights.get(key.removesuffix(_SCALE))
        if rounded is None or rounded.dtype != torch.int8 or scale.shape != (*rounded.shape[:1], 1):
            raise CheckpointError(f"{path} is damaged ({key} has no weights of its size); copy or download it again")
        weights[key.removesuffix(_SCALE)] = rounded.float() * scale.float()
    weights = {key: value.float() if value.dtype in half else value for key, value in weights.items()}
    check_numbers(path, weights)
    return weights


def check_numbers(path: Path, weights: Mapping[str, Tensor]) -> None:
    """Refuse weights that are complex, infinite or not a number.

    Raises CheckpointError if some are; the first is named.
    """
    for key, value in weights.items():
        is_number = not value.is_complex()
        if value.is_floating_point() and value.numel():
            is_number = all(map(torch.isfinite, value.float().aminmax()))
        if not is_number:
            raise CheckpointError(f"{path} is damaged ({key[:80]} holds what is no number); copy or download it again")


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
    own = module.state_dict()
    problems = [f"missing {key}" for key in own if key not in weights]
    problems += [f"unknown {key}" for key in weights if key not in own]
    problems += [
        f"{key} is {tuple(weights[key].shape)}, wanted {tuple(own[key].shape)}"
        for key in own
        if key in weights and weights[key].shape != own[key].shape
    ]
    if problems:
        shown = "; ".join(problems[:6]) + (f"; and {len(problems) - 6} more" if len(problems) > 6 else "")
        raise CheckpointError(f"{origin} does not fit this model: {shown}")
    module.load_state_dict(dict(weights))


def round_to_int8(weight: Float[Tensor, "o i"]) -> tuple[Int8[Tensor, "o i"], Float[Tensor, "o 1"]]:
    """Stochastic rounding to int8: the integers, and one scale for each row; the weights are about integers x scale.

    A weight a tenth of a step above an integer is rounded up with a probability of a tenth, so the mean error is zero.
    The seed is fixed, so the same weights always give the same integers. Rounding to the nearest integer would undo
    every change of less than half a step: a few steps of `align` on a generator that is stored in int8 change less.
    Weights that are integers x scale already keep their integers.
    """
    scale = (weight.abs().amax(1, keepdim=True) / 127).clamp(min=1e-12)
    threshold = torch.rand(weight.shape, generator=torch.Generator().manual_seed(0)) * (1 - 2 * _EXACT) + _EXACT
    rounded = (weight.cpu() / scale.cpu() + threshold).floor().clamp(-127, 127)
    return rounded.to(weight.device, torch.int8), scale.float()


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
            kept, stored[key + _SCALE] = round_to_int8(kept)
        elif dtype is not None and kept.is_floating_point():
            kept = kept.to(torch.float16 if dtype == torch.int8 else dtype)
        stored[key] = kept.contiguous()
    path = folder / "model.safetensors"
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
