"""Octets in arrays, of one row or of two: how compiled loops over sessions read and write (`octet`).

Octets live in the last axis of C-contiguous float32 arrays of length 8:

    x = load(turns, (row, joint, 1))              # turns[row, joint, 1, :]
    store(turns, (row, joint, 1), where(x < ZERO, -x, x))

A row may be two, `(0, 1)`: x is then a pair of octets, and the same lines are compiled for both sessions at once, which
costs little more than one where registers hold sixteen numbers. What a session has one of is read by `number`, and what
is done frame by frame is done for each of `sessions(row)`. A loop starts `ALONE` or `IN_PAIRS`:

    for _ in range(turns.shape[0] // len(sessions(row))):
        ...
        row = following(row)
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from .octet import LANES, OCTET, PAIR, joined, spread_by

ALONE, IN_PAIRS = 0, (0, 1)  # where a loop over rows starts: one by one, or two by two
_INT = ir.IntType(32)


def _kind_at(index: Any) -> Any:
    """What stands at an index: a row may be one or two."""
    return PAIR if isinstance(index[0], types.UniTuple) else OCTET


def _places(
    context: Any, builder: Any, array_type: Any, array: Any, index_type: Any, index: Any
) -> list[Any]:
    """Pointers to the numbers at this index, one for each row."""
    first, *others = cgutils.unpack_tuple(builder, index)
    rows = cgutils.unpack_tuple(builder, first) if isinstance(index_type[0], types.UniTuple) else [first]
    row_type = index_type[0].dtype if isinstance(index_type[0], types.UniTuple) else index_type[0]
    kinds = [row_type, *list(index_type)[1:]]
    view = context.make_array(array_type)(context, builder, array)
    places = []
    for row in rows:
        indices = [
            context.cast(builder, i, t, types.intp) for i, t in zip([row, *others], kinds, strict=True)
        ]
        indices += [ir.Constant(indices[0].type, 0)] * (array_type.ndim - len(indices))
        places.append(cgutils.get_item_pointer(context, builder, array_type, view, indices, wraparound=False))
    return places


def _is_float_array(array: Any, index: Any, *spare: int) -> bool:
    return (
        isinstance(array, types.Array)
        and array.dtype == types.float32
        and array.layout == "C"
        and isinstance(index, types.BaseTuple)
        and array.ndim - len(index) in spare
    )


def _apart(builder: Any, value: Any, kind: Any) -> list[Any]:
    """The octets of a value."""
    if kind is OCTET:
        return [value]
    empty = ir.Constant(kind.vector, ir.Undefined)
    orders = [list(range(first, first + LANES)) for first in range(0, kind.lanes, LANES)]
    kind_of_order = ir.VectorType(_INT, LANES)
    return [builder.shuffle_vector(value, empty, ir.Constant(kind_of_order, order)) for order in orders]


@intrinsic  # type: ignore[untyped-decorator]
def load(typing: Any, array: Any, index: Any) -> Any:
    """`array[*index, 0:8]`, of both rows where the index has two; or, with an index more, eight from there on."""
    if not _is_float_array(array, index, 0, 1):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = _places(context, builder, array, arguments[0], index, arguments[1])
        parts = [builder.bitcast(place, OCTET.vector.as_pointer()) for place in places]
        return joined(builder, [builder.load(part, align=4) for part in parts])

    return _kind_at(index)(array, index), build


@intrinsic  # type: ignore[untyped-decorator]
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """`array[*index, 0:8] = value`, in both rows where the index has two; or, with an index more, from there on."""
    if not (_is_float_array(array, index, 0, 1) and value is _kind_at(index)):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = _places(context, builder, array, arguments[0], index, arguments[1])
        for place, part in zip(places, _apart(builder, arguments[2], value), strict=True):
            builder.store(part, builder.bitcast(place, OCTET.vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.none(array, index, value), build


@intrinsic  # type: ignore[untyped-decorator]
def number(typing: Any, array: Any, index: Any) -> Any:
    """`array[*index]`, the same for all frames of a row."""
    if not _is_float_array(array, index, 0):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = _places(context, builder, array, arguments[0], index, arguments[1])
        return joined(builder, [spread_by(builder, builder.load(place), OCTET) for place in places])

    return _kind_at(index)(array, index), build


def sessions(row: Any) -> Any:
    """The rows of a row, as a tuple: itself, or two."""
    return (row,) if isinstance(row, int) else row


@overload(sessions)
def _sessions(row):  # type: ignore[no-untyped-def]
    if isinstance(row, types.Integer):
        return lambda row: (row,)
    return lambda row: row


def desk(row: Any) -> Any:
    """The place of a row in scratch memory that holds one for each session at work: 0, or (0, 1)."""
    return 0 if isinstance(row, int) else (0, 1)


@overload(desk)
def _desk(row):  # type: ignore[no-untyped-def]
    if isinstance(row, types.Integer):
        return lambda row: 0
    return lambda row: (0, 1)


def following(row: Any) -> Any:
    """The next row, or the next two."""
    return row + 1 if isinstance(row, int) else (row[0] + 2, row[1] + 2)


@overload(following)
def _following(row):  # type: ignore[no-untyped-def]
    if isinstance(row, types.Integer):
        return lambda row: row + 1
    return lambda row: (row[0] + 2, row[1] + 2)


def blocks(frames: np.ndarray) -> np.ndarray:
    """Any number of frames in the last axis as whole octets, (n, ..., 8); the last frame is repeated to fill them."""
    short = -frames.shape[-1] % LANES
    filled = np.concatenate([frames, np.repeat(frames[..., -1:], short, -1)], -1) if short else frames
    cut = filled.reshape(*frames.shape[:-1], -1, LANES)
    return np.ascontiguousarray(np.moveaxis(cut, -2, 0), np.float32)
