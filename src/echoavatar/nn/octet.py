"""Eight numbers at once in compiled loops: the eight frames of a chunk as one register, or those of two sessions.

Numba leaves it to LLVM to see that a loop over eight frames could run side by side, and with dozens of arrays in the
loop LLVM gives up. An `Octet` says it: arithmetic on it is arithmetic on a vector of eight float32, on any processor
(two registers where they hold four). With `exact` nothing is reordered or fused, so that a number does not depend on
its neighbours, nor on the processor.

Compiled functions only: `exact` ones are called from Python and kept by numba between runs, `inner` ones are parts of
them (numba looks at the file of the `exact` one alone: delete `__pycache__` after changing an `inner` one elsewhere).
Octets live in the last axis of C-contiguous float32 arrays of length 8:

    x = load(turns, (row, joint, 1))              # turns[row, joint, 1, :]
    store(turns, (row, joint, 1), where(x < ZERO, -x, x))

A row may be two, `(0, 1)`: x is then a pair of octets, and the same lines are compiled for both sessions at once, which
costs about as much as one where registers hold sixteen numbers. What a session has one of is read by `number`, and what
is done frame by frame is done for each of `sessions(row)`.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, overload, register_model

exact = functools.partial(njit, cache=True, nogil=True, error_model="numpy")  # as written, in this order
inner = functools.partial(njit, error_model="numpy", forceinline=True)  # a part of those, compiled into them
LANES = 8
ALONE, IN_PAIRS = 0, (0, 1)  # where a loop over rows starts: one by one, or two by two
_INT = ir.IntType(32)


class _OctetsType(types.Type):  # type: ignore[misc]
    """Eight float32 of each of so many sessions."""

    def __init__(self, sessions: int) -> None:
        super().__init__(name=f"Octets{sessions}")
        self.lanes = sessions * LANES
        self.vector = ir.VectorType(ir.FloatType(), self.lanes)


class _MaskType(types.Type):  # type: ignore[misc]
    """As many truths."""

    def __init__(self, sessions: int) -> None:
        super().__init__(name=f"OctetsMask{sessions}")
        self.lanes = sessions * LANES
        self.vector = ir.VectorType(ir.IntType(1), self.lanes)


OCTET, PAIR = _OctetsType(1), _OctetsType(2)
_MASKS = {OCTET: _MaskType(1), PAIR: _MaskType(2)}


@register_model(_OctetsType)
@register_model(_MaskType)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, fe_type.vector)


# ---- places in arrays


def _kind_at(index: Any) -> Any:
    """What stands at an index: a row may be one or two."""
    return PAIR if isinstance(index[0], types.UniTuple) else OCTET


def _places(context: Any, builder: Any, array_type: Any, array: Any, index_type: Any, index: Any) -> list[Any]:
    """Pointers to the numbers at this index, one for each row."""
    first, *others = cgutils.unpack_tuple(builder, index)
    rows = cgutils.unpack_tuple(builder, first) if isinstance(index_type[0], types.UniTuple) else [first]
    row_type = index_type[0].dtype if isinstance(index_type[0], types.UniTuple) else index_type[0]
    kinds = [row_type, *list(index_type)[1:]]
    view = context.make_array(array_type)(context, builder, array)
    places = []
    for row in rows:
        indices = [context.cast(builder, i, t, types.intp) for i, t in zip([row, *others], kinds, strict=True)]
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


def _joined(builder: Any, parts: list[Any]) -> Any:
    """Octets side by side."""
    if len(parts) == 1:
        return parts[0]
    order = ir.Constant(ir.VectorType(_INT, 2 * LANES), list(range(2 * LANES)))
    return builder.shuffle_vector(*parts, order)


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
        return _joined(builder, [builder.load(part, align=4) for part in parts])

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
        return _joined(builder, [_spread(builder, builder.load(place), OCTET) for place in places])

    return _kind_at(index)(array, index), build


def sessions(row):  # type: ignore[no-untyped-def]
    """The rows of a row, as a tuple: itself, or two."""
    return (row,) if isinstance(row, int) else row


@overload(sessions)  # type: ignore[untyped-decorator]
def _sessions(row):  # type: ignore[no-untyped-def]
    if isinstance(row, types.Integer):
        return lambda row: (row,)
    return lambda row: row


def desk(row):  # type: ignore[no-untyped-def]
    """The place of a row in scratch memory that holds one for each session at work: 0, or (0, 1)."""
    return 0 if isinstance(row, int) else (0, 1)


@overload(desk)  # type: ignore[untyped-decorator]
def _desk(row):  # type: ignore[no-untyped-def]
    if isinstance(row, types.Integer):
        return lambda row: 0
    return lambda row: (0, 1)


def following(row):  # type: ignore[no-untyped-def]
    """The next row, or the next two."""
    return row + 1 if isinstance(row, int) else (row[0] + 2, row[1] + 2)


@overload(following)  # type: ignore[untyped-decorator]
def _following(row):  # type: ignore[no-untyped-def]
    if isinstance(row, types.Integer):
        return lambda row: row + 1
    return lambda row: (row[0] + 2, row[1] + 2)


# ---- arithmetic


def _spread(builder: Any, scalar: Any, kind: Any) -> Any:
    empty = ir.Constant(kind.vector, ir.Undefined)
    one = builder.insert_element(empty, scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(_INT, kind.lanes), [0] * kind.lanes))


def _common(*given: Any) -> Any:
    """The kind that an operation on these makes; None where that is not one."""
    if any(kind not in (OCTET, PAIR, types.float32) for kind in given):
        return None
    return PAIR if PAIR in given else OCTET if OCTET in given else None


def _as(builder: Any, value: Any, given: Any, kind: Any) -> Any:
    """A number for every frame, an octet for both sessions."""
    if given is kind:
        return value
    return _spread(builder, value, kind) if given == types.float32 else _joined(builder, [value, value])


def _on_both(build: Callable[[Any, Any, Any], Any], given: tuple[Any, Any]) -> Any:
    """The code of an operation on two values."""
    common = _common(*given)

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pairs = zip(arguments, given, strict=True)
        return build(builder, *(_as(builder, value, kind, common) for value, kind in pairs))

    return code


_KINDS = (OCTET, PAIR, types.float32)
_COUPLES = [(a, b) for a in _KINDS for b in _KINDS if _common(a, b) is not None]


def _define(operation: Callable[..., Any], is_mask: bool, build: Callable[[Any, Any, Any], Any]) -> None:
    """An operator; as a template and not as an overload, which would be a function to inline at every use."""
    made = {couple: _MASKS[_common(*couple)] if is_mask else _common(*couple) for couple in _COUPLES}
    cases = [signature(result, *couple) for couple, result in made.items()]
    infer_global(operation)(type("_Template", (ConcreteTemplate,), {"cases": cases}))
    for couple in _COUPLES:
        lower_builtin(operation, *couple)(_on_both(build, couple))


_define(operator.add, False, lambda builder, x, y: builder.fadd(x, y))
_define(operator.iadd, False, lambda builder, x, y: builder.fadd(x, y))
_define(operator.sub, False, lambda builder, x, y: builder.fsub(x, y))
_define(operator.mul, False, lambda builder, x, y: builder.fmul(x, y))
_define(operator.truediv, False, lambda builder, x, y: builder.fdiv(x, y))
_define(operator.lt, True, lambda builder, x, y: builder.fcmp_ordered("<", x, y))
_define(operator.gt, True, lambda builder, x, y: builder.fcmp_ordered(">", x, y))


@infer_global(operator.neg)
class _Negative(ConcreteTemplate):  # type: ignore[misc]
    cases = [signature(kind, kind) for kind in (OCTET, PAIR)]


@lower_builtin(operator.neg, OCTET)  # type: ignore[untyped-decorator]
@lower_builtin(operator.neg, PAIR)  # type: ignore[untyped-decorator]
def _negative(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return builder.fneg(arguments[0])


def _chosen(sign: str) -> Any:
    """The first where it compares so with the second, which stands where they cannot be compared."""

    @intrinsic  # type: ignore[untyped-decorator]
    def operation(typing: Any, a: Any, b: Any) -> Any:
        if (common := _common(a, b)) is None:
            return None
        return common(a, b), _on_both(
            lambda builder, x, y: builder.select(builder.fcmp_ordered(sign, x, y), x, y), (a, b)
        )

    return operation


least, most = _chosen("<"), _chosen(">")


def _of_one(build: Callable[[Any, Any, Any], Any]) -> Any:
    @intrinsic  # type: ignore[untyped-decorator]
    def operation(typing: Any, value: Any) -> Any:
        if value not in (OCTET, PAIR):
            return None
        return value(value), lambda context, builder, signature, arguments: build(builder, arguments[0], value)

    return operation


def _call(builder: Any, name: str, vector: Any, kind: Any) -> Any:
    of = ir.FunctionType(kind.vector, [kind.vector])
    made = cgutils.get_or_insert_function(builder.module, of, f"llvm.{name}.v{kind.lanes}f32")
    return builder.call(made, [vector])


def _shuffled(builder: Any, x: Any, y: Any, kind: Any, order: list[int]) -> Any:
    """Numbers of two values in another order within each octet; those of the second count from 8."""
    whole = [
        at % LANES + first + (kind.lanes if at >= LANES else 0)
        for first in range(0, kind.lanes, LANES)
        for at in order
    ]
    return builder.shuffle_vector(x, y, ir.Constant(ir.VectorType(_INT, kind.lanes), whole))


@intrinsic  # type: ignore[untyped-decorator]
def fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """`a * b + c`, rounded once: half the work where the processor can, the same number where it cannot."""
    if (common := _common(a, b, c)) is None:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = [_as(builder, value, kind, common) for value, kind in zip(arguments, (a, b, c), strict=True)]
        of = ir.FunctionType(common.vector, [common.vector] * 3)
        made = cgutils.get_or_insert_function(builder.module, of, f"llvm.fma.v{common.lanes}f32")
        return builder.call(made, given)

    return common(a, b, c), build


root = _of_one(lambda builder, x, kind: _call(builder, "sqrt", x, kind))
size = _of_one(lambda builder, x, kind: _call(builder, "fabs", x, kind))
first_of = _of_one(lambda builder, x, kind: _shuffled(builder, x, x, kind, [0] * LANES))
last_of = _of_one(lambda builder, x, kind: _shuffled(builder, x, x, kind, [LANES - 1] * LANES))


@intrinsic  # type: ignore[untyped-decorator]
def spread(typing: Any, scalar: Any, like: Any) -> Any:
    """A number for every frame, as wide as another value."""
    if scalar != types.float32 or like not in (OCTET, PAIR):
        return None
    return like(scalar, like), lambda context, builder, signature, arguments: _spread(builder, arguments[0], like)


@intrinsic  # type: ignore[untyped-decorator]
def is_any(typing: Any, mask: Any) -> Any:
    """Whether it is true for any frame of any session."""
    if mask not in _MASKS.values():
        return None
    bits = ir.IntType(mask.lanes)

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.icmp_unsigned("!=", builder.bitcast(arguments[0], bits), ir.Constant(bits, 0))

    return types.boolean(mask), build


@intrinsic  # type: ignore[untyped-decorator]
def where(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """The first value where the mask is true, the second elsewhere."""
    common = _common(a, b, OCTET if mask is _MASKS[OCTET] else PAIR)
    if mask not in _MASKS.values() or common is None or _MASKS[common] is not mask:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        x, y = _as(builder, arguments[1], a, common), _as(builder, arguments[2], b, common)
        return builder.select(arguments[0], x, y)

    return common(mask, a, b), build


@intrinsic  # type: ignore[untyped-decorator]
def behind(typing: Any, value: Any, first: Any) -> Any:
    """Each number's predecessor: the first of `first`, then the first seven."""
    if value not in (OCTET, PAIR) or _common(value, first) is not value:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        before = _as(builder, arguments[1], first, value)
        return _shuffled(builder, arguments[0], before, value, [LANES, *range(LANES - 1)])

    return value(value, first), build


@intrinsic  # type: ignore[untyped-decorator]
def transposed(typing: Any, rows: Any) -> Any:
    """Of eight octets: the first numbers of all, the second numbers, and so on."""
    if rows != types.UniTuple(OCTET, LANES):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        parts = cgutils.unpack_tuple(builder, arguments[0])
        for reach in (4, 2, 1):  # blocks of so many rows and columns change places across the diagonal
            low = [at if not at & reach else at - reach + LANES for at in range(LANES)]
            high = [at + reach if not at & reach else at + LANES for at in range(LANES)]
            for row in range(LANES):
                if not row & reach:
                    x, y = parts[row], parts[row + reach]
                    parts[row] = _shuffled(builder, x, y, OCTET, low)
                    parts[row + reach] = _shuffled(builder, x, y, OCTET, high)
        return context.make_tuple(builder, signature.return_type, parts)

    return rows(rows), build


def blocks(frames: np.ndarray) -> np.ndarray:
    """Any number of frames in the last axis as whole octets, (n, ..., 8); the last frame is repeated to fill them."""
    short = -frames.shape[-1] % LANES
    filled = np.concatenate([frames, np.repeat(frames[..., -1:], short, -1)], -1) if short else frames
    cut = filled.reshape(*frames.shape[:-1], -1, LANES)
    return np.ascontiguousarray(np.moveaxis(cut, -2, 0), np.float32)
