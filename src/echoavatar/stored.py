"""What a checkpoint folder stores: `config.json`, `model.safetensors`, `card.json`.

Nothing is ever unpickled. Uses `config`, `json_reader`, `limits` and `errors` only.
"""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float, Int8
from pydantic import ValidationError
from safetensors import SafetensorError, deserialize

from .config import Config
from .errors import CheckpointError, EchoAvatarError
from .json_reader import read_object_file
from .limits import CONFIG_BYTES, check_file

ConfigT = TypeVar("ConfigT", bound=Config)
WEIGHTS = "model.safetensors"
LARGEST_WEIGHTS_BYTES = 1 << 36
SCALE = ".int8_scale"
_TYPES = {"F64": "f8", "F32": "f4", "F16": "f2", "BF16": "u2", "BOOL": "?"}
_TYPES |= {f"{kind}{8 * size}": f"{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)}
_EXACT = 1e-3  # a weight this close to an integer, in steps, is always rounded to it; covers float32 errors


class Rounded(NamedTuple):
    """A matrix that is about integers x scale, one scale for each row."""

    integers: Int8[np.ndarray, "o i"]
    scale: Float[np.ndarray, "o 1"]

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns."""
        return self.integers.shape

    def floats(self) -> Float[np.ndarray, "o i"]:
        """The matrix."""
        return np.asarray(self.integers * self.scale)


Stored = np.ndarray | Rounded


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
    """The model card (data, command, scores, licence); {} if there is none. Raises CheckpointError: it is damaged."""
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


def read_arrays(folder: Path) -> dict[str, Stored]:
    """Read `model.safetensors`. Half precision becomes float32; int8 matrices with a scale become `Rounded`.

    Raises CheckpointError if the file is missing or damaged, or holds no numbers or values that are not finite.
    """
    path = folder / WEIGHTS
    try:
        check_weights(path)
        entries = dict(deserialize(path.read_bytes()))  # type: ignore[no-untyped-call]
    except FileNotFoundError as error:
        raise CheckpointError(f"{folder} is not a checkpoint: {WEIGHTS} is missing") from error
    except SafetensorError as error:
        raise CheckpointError(f"{path} is damaged ({error}); copy or download it again") from error
    arrays = {key: _array(path, key, entry) for key, entry in entries.items()}
    for key, value in arrays.items():
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise CheckpointError(f"{path} is damaged ({key[:80]} holds what is no number); copy or download it again")
    found: dict[str, Stored] = dict(arrays)
    for key in [key for key in arrays if key.endswith(SCALE)]:
        scale, rounded = arrays[key], arrays.get(key.removesuffix(SCALE))
        if rounded is None or rounded.dtype != np.int8 or scale.shape != (*rounded.shape[:1], 1):
            raise CheckpointError(f"{path} is damaged ({key} has no weights of its size); copy or download it again")
        del found[key]
        found[key.removesuffix(SCALE)] = Rounded(rounded, scale)
    return found


def check_shapes(wanted: Mapping[str, Sequence[int]], given: Mapping[str, Sequence[int]], *, origin: str) -> None:
    """Refuse weights whose names or shapes are not the model's. Raises CheckpointError that lists the differences."""
    problems = [f"missing {key}" for key in wanted if key not in given]
    problems += [f"unknown {key}" for key in given if key not in wanted]
    problems += [
        f"{key} is {tuple(given[key])}, wanted {tuple(shape)}"
        for key, shape in wanted.items()
        if key in given and tuple(given[key]) != tuple(shape)
    ]
    if problems:
        shown = "; ".join(problems[:6]) + (f"; and {len(problems) - 6} more" if len(problems) > 6 else "")
        raise CheckpointError(f"{origin} does not fit this model: {shown}")


def round_to_int8(weight: Float[np.ndarray, "o i"]) -> Rounded:
    """Stochastic rounding to int8, with one scale per row.

    A weight a tenth of a step above an integer is rounded up with a probability of a tenth, so the mean error is zero.
    The seed is fixed, so the same weights always give the same integers. Rounding to the nearest integer would undo
    every change of less than half a step: a few steps of `align` on a generator that is stored in int8 change less.
    Weights that are integers x scale already keep their integers.
    """
    scale = np.maximum(np.abs(weight).max(1, keepdims=True) / np.float32(127), np.float32(1e-12))
    rounded = weight / scale
    rounded += _thresholds(1 << (weight.size - 1).bit_length())[: weight.size].reshape(weight.shape)
    np.clip(np.floor(rounded, out=rounded), -127, 127, out=rounded)
    return Rounded(rounded.astype(np.int8), scale)


@functools.lru_cache(maxsize=1)
def _thresholds(count: int) -> Float[np.ndarray, " n"]:
    """For each weight of a matrix, the part of a step from which it is rounded up."""
    drawn = np.frombuffer(np.random.RandomState(0).bytes(4 * count), "<u4")  # as torch's generator with seed 0
    threshold = (drawn & 0xFFFFFF).astype(np.float32)
    return threshold * np.float32(2.0**-24) * np.float32(1 - 2 * _EXACT) + np.float32(_EXACT)


def _array(path: Path, key: str, entry: Mapping[str, object]) -> np.ndarray:
    kind = str(entry["dtype"])
    if kind not in _TYPES:
        raise CheckpointError(f"{path} is damaged ({key[:80]} holds what is no number); copy or download it again")
    value: np.ndarray = np.frombuffer(entry["data"], _TYPES[kind]).reshape(entry["shape"])  # type: ignore[call-overload]
    if kind == "BF16":
        value = (value.astype(np.uint32) << 16).view(np.float32)
    return value.astype(np.float32) if kind == "F16" else value
