"""Arrays of numbers out of a pickle, read without running it; and the columns of a data frame that pandas pickled.

Python's unpickler calls what the file names, sets attributes on it, and makes objects as large as the file asks. This
reader is a small machine of its own. It knows the instructions that NumPy's pickles consist of, holds numbers, texts,
bytes, tuples, lists and dictionaries, and builds arrays itself from bytes whose number fits. Objects of classes that
the caller names are noted with their arguments, and never made. Every other instruction ends it, and so do more steps
or bytes than `limits` allows.

A data frame is pickled as blocks: arrays of (columns, rows), each with the places of its columns, and two indices, of
columns and of rows. Its objects are noted, and its columns put together by name, without pandas. The index of rows is
not read. Known are pandas 1.3 to 3, and the older form, whose blocks lie in the manager's state.
"""

import io
import math
import pickletools
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from echoavatar.limits import PICKLED_STEPS

_NUMBERS = ("<f4", "<f8", "<i4", "<i8", "f4", "f8", "i4", "i8")
_SPANS = {"m8": "i8", "<m8": "i8"}  # lengths of time are counted in whole units
_MOST_AXES = 32
_SLACK_BYTES = 1 << 16  # what a pickle of any size may allocate
_RECONSTRUCT = ("numpy.core.multiarray _reconstruct", "numpy._core.multiarray _reconstruct")
_FROM_BUFFER = ("numpy.core.numeric _frombuffer", "numpy._core.numeric _frombuffer")
_ENCODE, _DTYPE, _NDARRAY = "_codecs encode", "numpy dtype", "numpy ndarray"
_KNOWN = (*_RECONSTRUCT, *_FROM_BUFFER, _ENCODE, _DTYPE, _NDARRAY)


class RefusedError(Exception):
    """The pickle asks for something that is no array."""


@dataclass
class PickledArray:
    """An array of the pickle: numbers, or the list of objects that an object array holds."""

    content: "np.ndarray | list[Any] | None" = None


@dataclass
class PickledObject:
    """An object that the pickle describes and that is not made: its class or function, its arguments, its state."""

    name: str
    arguments: tuple[Any, ...] = ()
    state: Any = None


@dataclass
class _Name:
    """A module's attribute that the pickle names."""

    name: str


@dataclass
class _Kind:
    """An array's data type as the pickle names it."""

    name: str


class _Mark:
    """Where a tuple, list or dictionary begins on the stack."""


def unpickle_arrays(data: bytes, noted: Collection[str] = ()) -> Any:
    """The content of a pickle, with a `PickledArray` for each array.

    `noted`: classes and functions ("module name") of which a `PickledObject` takes the place, without being called.

    Raises:
        RefusedError: the pickle names anything but an array, or asks for more than it brings.
        Exception: the pickle is damaged.
    """
    return _Machine(data, noted).run()


class _Machine:
    def __init__(self, data: bytes, noted: Collection[str]) -> None:
        self._data, self._noted = data, frozenset(noted)
        self._stack: list[Any] = []
        self._memo: dict[int, Any] = {}
        self._allowance = 2 * len(data) + _SLACK_BYTES  # bytes that arrays and encoded texts may take
        self._verbs: dict[str, Callable[[], object]] = {
            "MARK": lambda: self._stack.append(_Mark()),
            "POP": lambda: self._take(1),
            "POP_MARK": self._to_mark,
            "DUP": lambda: self._stack.append(self._stack[-1]),
            "NONE": lambda: self._stack.append(None),
            "NEWTRUE": lambda: self._stack.append(True),
            "NEWFALSE": lambda: self._stack.append(False),
            "EMPTY_TUPLE": lambda: self._stack.append(()),
            "EMPTY_LIST": lambda: self._stack.append([]),
            "EMPTY_DICT": lambda: self._stack.append({}),
            "TUPLE": lambda: self._stack.append(tuple(self._to_mark())),
            "TUPLE1": lambda: self._stack.append(tuple(self._take(1))),
            "TUPLE2": lambda: self._stack.append(tuple(self._take(2))),
            "TUPLE3": lambda: self._stack.append(tuple(self._take(3))),
            "LIST": lambda: self._stack.append(self._to_mark()),
            "DICT": lambda: self._stack.append(_pairs(self._to_mark())),
            "APPEND": lambda: self._extend(self._take(1)),
            "APPENDS": lambda: self._extend(self._to_mark()),
            "SETITEM": lambda: self._update(self._take(2)),
            "SETITEMS": lambda: self._update(self._to_mark()),
            "MEMOIZE": lambda: self._memo.update({len(self._memo): self._stack[-1]}),
            "STACK_GLOBAL": self._stack_global,
            "REDUCE": self._reduce,
            "BUILD": self._build,
            "NEWOBJ": self._new_object,
        }

    def run(self) -> Any:
        for step, (opcode, argument, _) in enumerate(pickletools.genops(io.BytesIO(self._data))):
            if step >= PICKLED_STEPS:
                raise RefusedError(f"it has more than {PICKLED_STEPS:,} instructions")
            if opcode.name == "STOP":
                return self._stack[-1]
            self._step(opcode.name, argument)
        raise RefusedError("it has no end")

    def _step(self, name: str, argument: Any) -> None:
        if name in ("PROTO", "FRAME"):
            return
        if name in self._verbs:
            self._verbs[name]()
        elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
            self._memo[argument] = self._stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            self._stack.append(self._memo[argument])
        elif name == "GLOBAL":
            self._stack.append(self._known(str(argument)))
        elif name in ("NEWOBJ_EX", "INST", "OBJ", "EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID"):
            raise RefusedError(f"it makes an object ({name}), which arrays never need")
        elif isinstance(argument, int | float | str | bytes | bytearray) and "STRING" not in name:
            self._stack.append(bytes(argument) if isinstance(argument, bytearray) else argument)
        else:
            raise RefusedError(f"it holds the instruction {name}, which arrays never need")

    def _take(self, count: int) -> list[Any]:
        if len(self._stack) < count:
            raise RefusedError("its stack runs out")
        taken = self._stack[len(self._stack) - count :]
        del self._stack[len(self._stack) - count :]
        return taken

    def _to_mark(self) -> list[Any]:
        for place in range(len(self._stack) - 1, -1, -1):
            if isinstance(self._stack[place], _Mark):
                taken = self._stack[place + 1 :]
                del self._stack[place:]
                return taken
        raise RefusedError("its stack has no mark")

    def _extend(self, items: list[Any]) -> None:
        """Append to the list on top of the stack."""
        found = self._stack[-1]
        if not isinstance(found, list):
            raise RefusedError("it appends to something that is no list")
        found.extend(items)

    def _update(self, items: list[Any]) -> None:
        """Set entries of the dictionary on top of the stack."""
        found = self._stack[-1]
        if not isinstance(found, dict):
            raise RefusedError("it sets an entry of something that is no dictionary")
        found.update(_pairs(items))

    def _stack_global(self) -> None:
        module, name = self._take(2)
        if not isinstance(module, str) or not isinstance(name, str):
            raise RefusedError("it names something that is no text")
        self._stack.append(self._known(f"{module} {name}"))

    def _reduce(self) -> None:
        called, arguments = self._take(2)
        if not isinstance(called, _Name) or not isinstance(arguments, tuple):
            raise RefusedError("it calls something that is no function")
        if called.name in self._noted:
            self._stack.append(PickledObject(called.name, arguments))
        elif called.name in _RECONSTRUCT:
            self._stack.append(PickledArray())
        elif called.name in _FROM_BUFFER and len(arguments) == 4:
            raw, kind, shape, order = arguments
            self._stack.append(PickledArray(self._numbers(raw, kind, shape, is_fortran=order == "F")))
        elif called.name == _DTYPE and arguments and isinstance(arguments[0], str):
            self._stack.append(_Kind(arguments[0]))
        elif called.name == _ENCODE and len(arguments) == 2 and isinstance(arguments[0], str):
            if arguments[1] != "latin1":
                raise RefusedError("it asks for another encoding than latin1")
            self._spend(len(arguments[0]))
            self._stack.append(arguments[0].encode("latin1"))
        else:
            raise RefusedError(f"it calls {called.name} with other arguments than arrays do")

    def _build(self) -> None:
        target, state = self._take(2)
        if isinstance(target, PickledObject):
            target.state = state
        elif not isinstance(state, tuple):
            raise RefusedError("it sets a state that is no tuple")
        elif isinstance(target, _Kind):
            if len(state) > 1 and state[1] == ">":
                raise RefusedError("it holds numbers of the other byte order (big-endian)")
        elif isinstance(target, PickledArray) and len(state) >= 4:
            *_, shape, kind, is_fortran, raw = state
            if isinstance(kind, _Kind) and kind.name in ("O8", "|O", "O") and isinstance(raw, list):
                target.content = raw
            else:
                target.content = self._numbers(raw, kind, shape, is_fortran=is_fortran is True)
        else:
            raise RefusedError("it sets the state of something that is no array")
        self._stack.append(target)

    def _new_object(self) -> None:
        kind, arguments = self._take(2)
        if not isinstance(kind, _Name) or kind.name not in self._noted or not isinstance(arguments, tuple):
            raise RefusedError("it makes an object (NEWOBJ), which arrays never need")
        self._stack.append(PickledObject(kind.name, arguments))

    def _known(self, name: str) -> _Name:
        if name not in _KNOWN and name not in self._noted:
            raise RefusedError(f"it would run {name.replace(' ', '.')[:80]} when read, which arrays never need")
        return _Name(name)

    def _numbers(self, raw: Any, kind: Any, shape: Any, *, is_fortran: bool) -> np.ndarray:
        if not isinstance(kind, _Kind) or kind.name not in (*_NUMBERS, *_SPANS):
            raise RefusedError(f"it holds an array of {kind.name[:40] if isinstance(kind, _Kind) else 'objects'!r}")
        if not isinstance(raw, bytes):
            raise RefusedError("it holds an array that is not made of bytes")
        is_shape = isinstance(shape, tuple) and len(shape) <= _MOST_AXES
        if not is_shape or not all(type(axis) is int and axis >= 0 for axis in shape):
            raise RefusedError("it holds an array without a shape")
        dtype = np.dtype(_SPANS.get(kind.name, kind.name))
        if math.prod(shape) * dtype.itemsize != len(raw):
            raise RefusedError(f"it holds {len(raw):,} bytes for an array of another size")
        self._spend(len(raw))
        return np.frombuffer(raw, dtype).reshape(shape, order="F" if is_fortran else "C").copy()

    def _spend(self, size: int) -> None:
        self._allowance -= size
        if self._allowance < 0:
            raise RefusedError("it asks for more memory than its own size explains")


def _pairs(items: list[Any]) -> dict[str, Any]:
    """Keys and values by turns; keys must be texts, whose hash costs no more than their length."""
    if len(items) % 2 or not all(isinstance(key, str) for key in items[::2]):
        raise RefusedError("it holds a dictionary whose keys are not all texts")
    return dict(zip(items[::2], items[1::2], strict=True))


NOTED = (
    "pandas DataFrame",
    "pandas Index",
    "pandas StringDtype",
    "pandas RangeIndex",
    "pandas TimedeltaIndex",
    "pandas.arrays StringArray",
    "pandas.arrays TimedeltaArray",
    "pandas.core.frame DataFrame",
    "pandas.core.internals.managers BlockManager",
    "pandas._libs.internals _unpickle_block",
    "pandas._libs.arrays __pyx_unpickle_NDArrayBacked",
    "pandas.core.indexes.base Index",
    "pandas.core.indexes.base _new_Index",
    "pandas.core.indexes.range RangeIndex",
    "pandas.core.indexes.timedeltas TimedeltaIndex",
    "pandas.core.indexes.timedeltas _new_TimedeltaIndex",
    "pandas.core.arrays.timedeltas TimedeltaArray",
    "builtins slice",
    "__builtin__ slice",
)
"""The names in a pickled data frame of numbers; none of them is imported or called."""
_OLD = "0.14.1"  # the key of the older form


def frame_columns(stored: Any) -> dict[str, np.ndarray]:
    """The columns of a data frame by name, each (rows,).

    Raises RefusedError if it is no data frame of numbers, or its columns do not fit its blocks.
    """
    if not isinstance(stored, PickledObject) or not stored.name.endswith(" DataFrame"):
        raise RefusedError("it holds no data frame")
    state = stored.state if isinstance(stored.state, dict) else {}
    manager = state.get("_mgr", state.get("_data"))
    if not isinstance(manager, PickledObject) or not manager.name.endswith(" BlockManager"):
        raise RefusedError("it holds a data frame without blocks")
    try:
        axes, blocks = _new_form(manager) if manager.arguments else _old_form(manager)
        names = _column_names(axes[0])
        found: list[np.ndarray | None] = [None] * len(names)
        for values, places in blocks:
            for place, row in zip(_places(places), _content(values), strict=True):
                found[place] = row
    except (TypeError, ValueError, IndexError, KeyError, AttributeError) as error:
        raise RefusedError(f"it holds a data frame of a form that is not known ({error})") from error
    if any(column is None for column in found) or len({len(column) for column in found if column is not None}) > 1:
        raise RefusedError("it holds a data frame whose columns do not fit its blocks")
    return {name: column for name, column in zip(names, found, strict=True) if column is not None}


def _new_form(manager: PickledObject) -> tuple[list[Any], list[tuple[Any, Any]]]:
    blocks, axes = manager.arguments[:2]
    return axes, [block.arguments[:2] for block in blocks]


def _old_form(manager: PickledObject) -> tuple[list[Any], list[tuple[Any, Any]]]:
    kept = manager.state[3][_OLD]
    return kept["axes"], [(block["values"], block["mgr_locs"]) for block in kept["blocks"]]


def _column_names(index: PickledObject) -> list[str]:
    """The texts of an index; newer pandas wraps their array once more."""
    data = index.arguments[1]["data"]
    if isinstance(data, PickledObject):
        data = next(part for part in data.state if isinstance(part, PickledArray))
    if not isinstance(data.content, list) or not all(isinstance(name, str) for name in data.content):
        raise RefusedError("it holds a data frame whose columns have no names")
    return data.content


def _places(places: Any) -> Iterator[int]:
    if isinstance(places, PickledArray):
        return (int(place) for place in _content(places))
    start, stop, step = places.arguments
    return iter(range(start, stop, step or 1))


def _content(array: PickledArray) -> np.ndarray:
    if not isinstance(array.content, np.ndarray):
        raise RefusedError("it holds a data frame of something else than numbers")
    return array.content
