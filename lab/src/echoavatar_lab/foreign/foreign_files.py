"""Readers of other people's files. They return tensors and numbers, or raise one error that names the file.

This is the only place of the project that opens pickled files. Torch files go through torch's own reader for weights,
after a scan of the names in them and of their unpacked size. NumPy's object arrays go through `pickled_arrays`, which
runs nothing. Sizes are checked before anything is allocated (`limits`).
"""

import io
import itertools
import pickletools
import zipfile
from collections.abc import Iterator, Mapping, Sized
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from echoavatar.errors import CheckpointError
from echoavatar.json_reader import read_object
from echoavatar.limits import ARRAYS_BYTES, CONFIG_BYTES, PICKLED_BYTES, check_file, read_bytes
from echoavatar.motion.formats.tables import NpzArrays, array_of

from .pickled_arrays import NOTED, PickledArray, RefusedError, frame_columns, unpickle_arrays

_WEIGHT_BYTES = 1 << 36  # of one torch file
_TENSORS = 20_000  # of one file; the release's generator has some 300
_TORCH_STEPS = 40 * _TENSORS  # instructions of a torch file's pickle; a tensor takes some 30
_TUPLE_DEPTH = 8  # of tuples in tuples: the hash of a key takes two to the power of it
_TORCH_NAMES = (  # the names in state dicts of models and optimisers; besides, torch's storages and data types
    "collections OrderedDict",
    "collections Counter",
    "torch Size",
    "torch._utils _rebuild_parameter",
    "torch._utils _rebuild_tensor_v2",
    "torch.storage UntypedStorage",
)
_MARK, _SLICE, _A_MARK = pickletools.markobject, pickletools.stackslice, -1
_MISSING_STATS = "is missing; it belongs to the release's stats folder"


@contextmanager
def _named(path: Path, missing: str = _MISSING_STATS) -> Iterator[None]:
    """Failures to read a file as CheckpointErrors that name it; `missing` ends the message where there is none."""
    try:
        yield
    except CheckpointError:
        raise
    except FileNotFoundError as error:
        raise CheckpointError(f"{path} {missing}") from error
    except RefusedError as error:
        raise CheckpointError(f"{path} is refused: {error}; fetch it again from where you trust") from error
    except Exception as error:  # a damaged file makes zipfile, pickletools, NumPy and torch raise errors of any kind
        reason = str(error).split("\n")[0][:120]
        what = f"{type(error).__name__}: {reason}"
        raise CheckpointError(f"{path} is damaged, cut off or of another kind ({what}); fetch it again") from error


def read_tensors(path: Path, key: str) -> dict[str, Tensor]:
    """The state dict under `key` of a torch file (torch 1.6 and later).

    Raises:
        CheckpointError: the file is missing, cut off, holds more than tensors and containers, or has no such entry.
    """
    with _named(path, "is missing; download it again"):
        check_file(path, _WEIGHT_BYTES, CheckpointError)
        check_torch_file(path)
        stored = torch.load(path, map_location="cpu", weights_only=True)  # noqa: TID251
    if not isinstance(stored, dict) or key not in stored:
        found = _listed(stored) if isinstance(stored, dict) else type(stored).__name__
        raise CheckpointError(f"{path} has no entry {key!r} (found: {found}); is it a file of the release?")
    tensors = stored[key]
    if not isinstance(tensors, dict) or not all(isinstance(value, Tensor) for value in tensors.values()):
        raise CheckpointError(f"{path}: {key!r} is no table of tensors; is it a file of the release?")
    for name, value in want_few(path, tensors).items():
        if not value.numel():
            raise CheckpointError(f"{path}: {str(name)[:80]} holds no numbers; download it again")
        if value.numel() * value.element_size() > value.untyped_storage().nbytes():
            raise CheckpointError(
                f"{path}: {str(name)[:80]} {list(value.shape)} is larger than its numbers; download it again"
            )
    named = {str(name): value for name, value in tensors.items()}
    check_numbers(path, named)
    return named


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


CountedT = TypeVar("CountedT", bound=Sized)


def want_few(path: Path, tensors: CountedT) -> CountedT:
    """Refuse a file of more tensors than any model of the release has. Raises CheckpointError if there are more."""
    if len(tensors) > _TENSORS:
        raise CheckpointError(
            f"{path} holds {len(tensors):,} tensors, at most {_TENSORS:,} are read; download it again"
        )
    return tensors


def check_torch_file(path: Path) -> None:
    """Refuse a torch file that would run something, or take more time or memory than weights need.

    Raises:
        CheckpointError: it would.
        Exception: it is damaged.
    """
    if foreign := _foreign_names(path):
        raise CheckpointError(
            f"{path} is refused: it would run {', '.join(foreign)} when read, which weights never need; "
            "do not open it with other programs, and download it again from where you trust"
        )


def _foreign_names(path: Path) -> list[str]:
    """The names in the pickle of a torch file that no state dict needs.

    Raises CheckpointError: the archive unpacks to more than its own size (torch never compresses).
    """
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > path.stat().st_size:
            raise CheckpointError(
                f"{path} unpacks to {unpacked:,} bytes, more than it has, which torch's files never do;"
                " download it again from where you trust"
            )
        pickles = [entry for entry in archive.namelist() if entry.endswith("/data.pkl")]
        if sum(archive.getinfo(entry).file_size for entry in pickles) > PICKLED_BYTES:
            raise RefusedError("its table of tensors is larger than any model's")
        names = set(itertools.chain.from_iterable(_names(archive.read(entry)) for entry in pickles))
    return sorted(name.replace(" ", ".")[:80] for name in names if not _is_of_torch(name))


def _names(data: bytes) -> Iterator[str]:
    """What a pickle names. More steps, or deeper tuples, than weights need are refused."""
    depths: list[int] = []  # of the tuples on the stack
    memo: dict[object, int] = {}
    for step, (opcode, argument, _) in enumerate(pickletools.genops(data)):
        if step > _TORCH_STEPS:
            raise RefusedError("it takes more steps than weights need")
        _follow(opcode, argument, depths, memo)
        if opcode.name == "GLOBAL":
            yield str(argument)
        elif opcode.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
            yield f"something by {opcode.name}"


def _follow(opcode: pickletools.OpcodeInfo, argument: object, depths: list[int], memo: dict[object, int]) -> None:
    """Do to the depths of tuples on the stack what an instruction does to the stack; -1 is a mark."""
    taken: list[int] = []
    if _MARK in opcode.stack_before:
        while (top := depths.pop()) != _A_MARK:
            taken.append(top)
    taken += [depths.pop() for kind in opcode.stack_before if kind not in (_MARK, _SLICE)]
    if opcode.name in ("PUT", "BINPUT", "LONG_BINPUT"):
        memo[argument] = depths[-1]
    elif opcode.name == "MEMOIZE":
        memo[len(memo)] = taken[0]
    deepest = max(taken, default=0)
    match opcode.name:
        case "MARK":
            made = _A_MARK
        case "GET" | "BINGET" | "LONG_BINGET":
            made = memo[argument]
        case "TUPLE" | "TUPLE1" | "TUPLE2" | "TUPLE3":
            made = deepest + 1
        case _:
            made = deepest if opcode.name in ("DUP", "MEMOIZE") else 0
    if made > _TUPLE_DEPTH:
        raise RefusedError("it holds tuples deeper than weights need")
    depths.extend([made] * len(opcode.stack_after))


def _is_of_torch(name: str) -> bool:
    module, _, attribute = name.partition(" ")
    is_storage = module == "torch" and attribute.endswith("Storage")
    is_dtype = module == "torch" and isinstance(getattr(torch, attribute, None), torch.dtype)
    return name in _TORCH_NAMES or is_storage or is_dtype


def read_array(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """A plain array of numbers of that shape (-1: any length) from an npy file.

    Raises CheckpointError: missing, damaged, of another shape, or with values that are not finite.
    """
    with _named(path):
        array = array_of(read_bytes(path, ARRAYS_BYTES, CheckpointError))
    return _checked(path, "the array", array, shape)


def read_table(path: Path, names: tuple[str, ...], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Arrays by name from an npy file that holds a pickled dictionary of them.

    Raises CheckpointError: missing, damaged, of another shape, or with anything but arrays of numbers in it.
    """
    with _named(path):
        file = io.BytesIO(read_bytes(path, PICKLED_BYTES, CheckpointError))
        is_first = np.lib.format.read_magic(file) == (1, 0)
        (np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0)(file)
        stored = unpickle_arrays(file.read())
    if isinstance(stored, PickledArray) and isinstance(stored.content, list) and len(stored.content) == 1:
        stored = stored.content[0]
    if not isinstance(stored, dict):
        raise CheckpointError(f"{path} holds no table of arrays; is it a file of the release?")
    found = {}
    for name in names:
        part = stored.get(name)
        if not isinstance(part, PickledArray) or not isinstance(part.content, np.ndarray):
            raise CheckpointError(f"{path} has no array {name!r} (found: {_listed(stored)})")
        found[name] = _checked(path, name, part.content, shape)
    return found


def read_pickled_table(path: Path) -> dict[str, object]:
    """The entries of a pickled dictionary by name: arrays of numbers as NumPy's, and plain numbers and texts.

    Raises CheckpointError: missing, damaged, no dictionary, or with anything in it that would run when read.
    """
    stored = _unpickled(path)
    if not isinstance(stored, dict):
        raise CheckpointError(f"{path} holds no table of arrays but a {type(stored).__name__}; give another file")
    return {name: part.content if isinstance(part, PickledArray) else part for name, part in stored.items()}


def read_pickled_frame(path: Path) -> dict[str, np.ndarray]:
    """The columns of a data frame of numbers that pandas pickled, by name, each (rows,).

    Raises CheckpointError: missing, damaged, no data frame, or with anything in it that would run when read.
    """
    stored = _unpickled(path, NOTED)
    try:
        return frame_columns(stored)
    except RefusedError as error:
        raise CheckpointError(
            f"{path} is refused: {error}; give a data frame of numbers as pandas pickles it"
        ) from error


def _unpickled(path: Path, noted: tuple[str, ...] = ()) -> object:
    with _named(path, "does not exist; check the name"):
        return unpickle_arrays(read_bytes(path, PICKLED_BYTES, CheckpointError), noted)


def read_pickled_array(data: bytes) -> np.ndarray:
    """One pickled array of numbers, as the release's tools send it over a socket.

    Raises CheckpointError if the bytes are anything else.
    """
    try:
        if len(data) > PICKLED_BYTES:
            raise RefusedError(f"it has {len(data):,} bytes")
        stored = unpickle_arrays(data)
    except Exception as error:  # refused, or damaged in any way
        raise CheckpointError(f"what came is no pickled array of numbers ({str(error)[:160]})") from error
    if not isinstance(stored, PickledArray) or not isinstance(stored.content, np.ndarray):
        raise CheckpointError("what came is no pickled array of numbers")
    return stored.content


def read_arrays(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Plain arrays by name from an npz file. Raises CheckpointError: missing, damaged, or without one of them."""
    with _named(path), NpzArrays(path, CheckpointError, most=PICKLED_BYTES) as stored:
        if missing := [name for name in names if name not in stored]:
            raise CheckpointError(f"{path} has no array {missing[0]!r}; is it a file of the release?")
        return {name: stored[name] for name in names}


def read_matrices(path: Path, names: tuple[str, ...]) -> np.ndarray:
    """The 3 x 3 rotation of each name (n, 3, 3) from a JSON table of 3 x 3 or 4 x 4 matrices.

    Raises CheckpointError: missing, damaged, or without one of the names.
    """
    with _named(path):
        stored = read_object(read_bytes(path, CONFIG_BYTES, CheckpointError), "it")
        missing = [name for name in names if name not in stored]
        if missing:
            raise CheckpointError(f"{path} has no matrix for {', '.join(missing[:6])} ({len(missing)} in all)")
        found = []
        for name in names:
            matrix = np.array(stored[name], np.float64)
            side = 4 if matrix.size == 16 else 3
            found.append(matrix.reshape(side, side)[:3, :3])
        return _checked(path, "the matrices", np.stack(found), (len(names), 3, 3))


def _listed(table: dict[object, object]) -> str:
    """The first keys of a table, for a message."""
    return ", ".join(str(key)[:40] for key in itertools.islice(table, 8)) or "nothing"


def _checked(path: Path, what: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    fits = array.ndim == len(shape) and all(w in (-1, n) for w, n in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in "fiu":
        raise CheckpointError(f"{path}: {what} is {array.dtype} {array.shape}, wanted numbers of shape {shape}")
    if not np.isfinite(array).all():
        raise CheckpointError(f"{path}: {what} holds values that are not finite; fetch it again")
    return array
