"""Reading files that somebody else made: tensors and numbers come out, or an error that says what and where.

The one place of the project where pickled files are opened. torch's come through its reader for weights, which builds
tensors and plain containers only. numpy's object arrays come through a reader of ours that knows three names and builds
arrays itself: no code of the file's choosing ever runs.
"""

import io
import json
import pickle  # noqa: TID251  # only to derive `_ArraysOnly`
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import CheckpointError

LARGEST_ARRAY = 64 << 20  # bytes of a pickled array; statistics have some hundred numbers
_NUMBERS = ("<f4", "<f8", "<i4", "<i8", "f4", "f8", "i4", "i8")


def read_tensors(path: Path, key: str) -> dict[str, Tensor]:
    """The state dict under `key` of a torch file.

    Raises:
        CheckpointError: the file is missing, cut off, holds more than tensors and containers, or has no such entry.
    """
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)  # noqa: TID251
    except FileNotFoundError as error:
        raise CheckpointError(f"{path} is missing; download it again") from error
    except pickle.UnpicklingError as error:
        names = ", ".join(_foreign_names(path)) or "something that is no tensor"
        raise CheckpointError(
            f"{path} is refused: it would run {names} when read, which weights never need; "
            "do not open it with other programs, and download it again from where you trust"
        ) from error
    except (RuntimeError, EOFError, OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        reason = str(error).split("\n")[0][:120]
        raise CheckpointError(f"{path} is damaged or cut off ({reason}); download it again") from error
    if not isinstance(stored, dict) or key not in stored:
        found = ", ".join(map(str, stored)) if isinstance(stored, dict) else type(stored).__name__
        raise CheckpointError(f"{path} has no entry {key!r} (found: {found}); is it a file of the release?")
    tensors = stored[key]
    if not isinstance(tensors, dict) or not all(isinstance(value, Tensor) for value in tensors.values()):
        raise CheckpointError(f"{path}: {key!r} is no table of tensors; is it a file of the release?")
    return {str(name): value for name, value in tensors.items()}


def _foreign_names(path: Path) -> list[str]:
    try:
        return sorted(torch.serialization.get_unsafe_globals_in_checkpoint(str(path)))
    except Exception:  # whatever a hostile file provokes, it is refused already
        return []


def read_array(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """A plain array of numbers of that shape (-1: any length) from an npy file.

    Raises:
        CheckpointError: missing, damaged, of another shape, or with values that are not finite.
    """
    try:
        array = np.load(path, allow_pickle=False)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path} is missing; it belongs to the release's stats folder") from error
    except (OSError, ValueError, EOFError) as error:
        raise CheckpointError(f"{path} is no plain array or is cut off ({error}); fetch it again") from error
    return _checked(path, "the array", array, shape)


def read_table(path: Path, names: tuple[str, ...], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Arrays by name from an npy file that holds a pickled dictionary of them.

    Raises:
        CheckpointError: missing, damaged, of another shape, or with anything but arrays of numbers in it.
    """
    try:
        with path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            header = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            header(file)
            stored = _ArraysOnly(io.BytesIO(file.read(LARGEST_ARRAY))).load()
    except FileNotFoundError as error:
        raise CheckpointError(f"{path} is missing; it belongs to the release's stats folder") from error
    except _RefusedError as error:
        raise CheckpointError(f"{path} is refused: {error}; fetch it again from where you trust") from error
    except Exception as error:  # a damaged pickle raises whatever it likes
        raise CheckpointError(
            f"{path} is damaged or cut off ({type(error).__name__}); fetch it again"
        ) from error
    if isinstance(stored, _Array) and isinstance(stored.content, list) and len(stored.content) == 1:
        stored = stored.content[0]
    if not isinstance(stored, dict):
        raise CheckpointError(f"{path} holds no table of arrays; is it a file of the release?")
    found = {}
    for name in names:
        part = stored.get(name)
        if not isinstance(part, _Array) or not isinstance(part.content, np.ndarray):
            raise CheckpointError(f"{path} has no array {name!r} (found: {', '.join(map(str, stored))})")
        found[name] = _checked(path, name, part.content, shape)
    return found


def read_pickled_array(data: bytes) -> np.ndarray:
    """One pickled array of numbers, as the release's tools send it over a socket.

    Raises:
        CheckpointError: anything else.
    """
    try:
        stored = _ArraysOnly(io.BytesIO(data)).load()
    except Exception as error:  # refused or damaged: it is no array
        raise CheckpointError(f"what came is no pickled array of numbers ({error})") from error
    if not isinstance(stored, _Array) or not isinstance(stored.content, np.ndarray):
        raise CheckpointError("what came is no pickled array of numbers")
    return stored.content


def read_arrays(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Plain arrays by name from an npz file.

    Raises:
        CheckpointError: missing, damaged, or without one of them.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: np.asarray(stored[name]) for name in names}
    except FileNotFoundError as error:
        raise CheckpointError(f"{path} is missing; it belongs to the release's stats folder") from error
    except KeyError as error:
        raise CheckpointError(f"{path} has no array {error}; is it a file of the release?") from error
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"{path} is damaged or holds pickles ({error}); fetch it again") from error


def read_matrices(path: Path, names: tuple[str, ...]) -> np.ndarray:
    """The rotational 3 x 3 of the matrix of each name (n, 3, 3) from a JSON table of 3 x 3 or 4 x 4 matrices.

    Raises:
        CheckpointError: missing, damaged, or without one of the names.
    """
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        missing = [name for name in names if name not in stored]
        if missing:
            raise CheckpointError(
                f"{path} has no matrix for {', '.join(missing[:6])} ({len(missing)} in all)"
            )
        found = []
        for name in names:
            matrix = np.array(stored[name], np.float64)
            side = 4 if matrix.size == 16 else 3
            found.append(matrix.reshape(side, side)[:3, :3])
        return _checked(path, "the matrices", np.stack(found), (len(names), 3, 3))
    except FileNotFoundError as error:
        raise CheckpointError(f"{path} is missing; it belongs to the release's stats folder") from error
    except (OSError, ValueError, TypeError) as error:
        raise CheckpointError(f"{path} is no table of matrices ({error}); fetch it again") from error


def _checked(path: Path, what: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    fits = array.ndim == len(shape) and all(w in (-1, n) for w, n in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in "fiu":
        raise CheckpointError(
            f"{path}: {what} is {array.dtype} {array.shape}, wanted numbers of shape {shape}"
        )
    if not np.isfinite(array).all():
        raise CheckpointError(f"{path}: {what} holds values that are not finite; fetch it again")
    return array


class _RefusedError(Exception):
    """The file asks for something that is no array."""


class _Kind:
    """Stands for numpy's dtype: its name, and that nothing else is asked of it."""

    def __init__(self, name: object, *_: object) -> None:
        self.name = str(name)

    def __setstate__(self, state: object) -> None:
        """Byte order and the like; little-endian is what all of these machines write."""


class _Array:
    """Stands for numpy's array: `content` is built here, from bytes whose number fits."""

    def __init__(self) -> None:
        self.content: np.ndarray | list[Any] | None = None

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        """(version, shape, kind, is Fortran's order, bytes or list)."""
        *_, shape, kind, is_fortran, raw = state
        if kind.name in ("O8", "|O", "O") and isinstance(raw, list):
            self.content = raw
        else:
            self.content = _numbers(raw, kind, shape, "F" if is_fortran else "C")


def _numbers(raw: Any, kind: _Kind, shape: Any, order: Any = "C") -> np.ndarray:
    if kind.name not in _NUMBERS:
        raise _RefusedError(f"it holds an array of {kind.name!r}")
    flat = np.frombuffer(bytes(raw), np.dtype(kind.name))
    return flat.reshape(tuple(int(n) for n in shape), order="F" if order == "F" else "C").copy()


def _reconstruct(*_: object) -> _Array:
    return _Array()


def _from_buffer(raw: Any, kind: _Kind, shape: Any, order: Any) -> _Array:
    array = _Array()
    array.content = _numbers(raw, kind, shape, order)
    return array


def _encode(text: str, encoding: str) -> bytes:
    """Bytes as Python 2 and protocol 2 write them."""
    if encoding != "latin1":
        raise _RefusedError(f"it asks for the encoding {encoding!r}")
    return text.encode("latin1")


class _ArraysOnly(pickle.Unpickler):
    """Knows these names and no others."""

    allowed: dict[tuple[str, str], Callable[..., Any]] = {  # noqa: RUF012
        ("numpy", "ndarray"): _Array,
        ("numpy", "dtype"): _Kind,
        ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
        ("numpy._core.multiarray", "_reconstruct"): _reconstruct,
        ("numpy.core.numeric", "_frombuffer"): _from_buffer,
        ("numpy._core.numeric", "_frombuffer"): _from_buffer,
        ("_codecs", "encode"): _encode,
    }

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in for a name, or a refusal."""
        found = self.allowed.get((module, name))
        if found is None:
            raise _RefusedError(f"it would run {module}.{name} when read, which arrays never need")
        return found

    def persistent_load(self, pid: Any) -> Any:
        """Nothing lies elsewhere."""
        raise _RefusedError("it points outside itself")
