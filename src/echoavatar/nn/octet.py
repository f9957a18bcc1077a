"""Eight numbers at once in compiled loops: the eight frames of a chunk as one register.

Numba leaves it to LLVM to see that a loop over eight frames could run side by side, and with dozens of arrays in the
loop LLVM gives up. An `Octet` says it: arithmetic on it is arithmetic on a vector of eight float32, on any processor
(two registers where they hold four). With `exact` nothing is reordered, and a product and a sum are rounded once only
where `fused` says so, so that a number does not depend on its neighbours, nor on the processor.

Compiled functions only: `exact` ones are called from Python and kept by numba between runs, `inner` ones are parts of
them (numba looks at the file of the `exact` one alone: delete `__pycache__` after changing an `inner` one elsewhere).
Octets live in the last axis of C-contiguous float32 arrays of length 8:

    x = load(turns, (row, joint, 1))              # turns[row, joint, 1, :]
    store(turns, (row, joint, 1), where(x < ZERO, -x, x))

The same operations are there for sixteen numbers (`wide`).
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
from numba.extending import intrinsic, lower_builtin, models, register_model
from numba.np.arrayobj import populate_array

# As written, in this order. Arrays are not counted (`_nrt`: that cost a tenth), so none can be made; see `scratch`.
exact = functools.partial(njit, cache=True, nogil=True, error_model="numpy", _nrt=False)
inner = functools.partial(
    njit, error_model="numpy", forceinline=True, _nrt=False
)  # a part of those, compiled into them
LANES = 8
_INT = ir.IntType(32)


class _NumbersType(types.Type):  # type: ignore[misc]
    """So many float32."""

    def __init__(self, lanes: int) -> None:
        super().__init__(name=f"Numbers{lanes}")
        self.lanes, self.vector = lanes, ir.VectorType(ir.FloatType(), lanes)


class _MaskType(types.Type):  # type: ignore[misc]
    """As many truths."""

    def __init__(self, lanes: int) -> None:
        super().__init__(name=f"Mask{lanes}")
        self.lanes, self.vector = lanes, ir.VectorType(ir.IntType(1), lanes)


OCTET, SIXTEEN = _NumbersType(LANES), _NumbersType(2 * LANES)
_MASKS = {kind: _MaskType(kind.lanes) for kind in (OCTET, SIXTEEN)}


@register_model(_NumbersType)
@register_model(_MaskType)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, fe_type.vector)


# ---- places in arrays


def place_of(context: Any, builder: Any, array_type: Any, array: Any, index_type: Any, index: Any) -> Any:
    """Pointer to the number at this index; axes that it leaves out count as 0."""
    given = zip(cgutils.unpack_tuple(builder, index), index_type, strict=True)
    indices = [context.cast(builder, value, kind, types.intp) for value, kind in given]
    indices += [ir.Constant(indices[0].type, 0)] * (array_type.ndim - len(indices))
    view = context.make_array(array_type)(context, builder, array)
    return cgutils.get_item_pointer(context, builder, array_type, view, indices, wraparound=False)


def _holds_octets(array: Any, index: Any) -> bool:
    return (
        isinstance(array, types.Array)
        and array.dtype == types.float32
        and array.layout == "C"
        and isinstance(index, types.BaseTuple)
        and array.ndim - len(index) in (0, 1)
    )


@intrinsic  # type: ignore[untyped-decorator]
def scratch(typing: Any, shape: Any) -> Any:
    """An array of float32 on the stack, until the function ends: not in a loop, and of some ten thousand numbers."""
    if not isinstance(shape, types.BaseTuple):
        return None
    kind = types.Array(types.float32, len(shape), "C")

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        sizes = [
            context.cast(builder, size, given, types.intp)
            for size, given in zip(cgutils.unpack_tuple(builder, arguments[0]), shape, strict=True)
        ]
        item, strides, count = ir.Constant(sizes[0].type, 4), list[Any](), ir.Constant(sizes[0].type, 1)
        for size in reversed(sizes):
            strides.insert(0, builder.mul(count, item))
            count = builder.mul(count, size)
        place = builder.alloca(ir.FloatType(), size=count)
        place.align = 64
        made = context.make_array(kind)(context, builder)
        populate_array(made, place, sizes, strides, item, None)
        return made._getvalue()

    return kind(shape), build


@intrinsic  # type: ignore[untyped-decorator]
def load(typing: Any, array: Any, index: Any) -> Any:
    """`array[*index, 0:8]`; or, with an index more, eight numbers from there on."""
    if not _holds_octets(array, index):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = place_of(context, builder, array, arguments[0], index, arguments[1])
        return builder.load(builder.bitcast(place, OCTET.vector.as_pointer()), align=4)

    return OCTET(array, index), build


@intrinsic  # type: ignore[untyped-decorator]
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """`array[*index, 0:8] = value`; or, with an index more, from there on."""
    if not (_holds_octets(array, index) and value is OCTET):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = place_of(context, builder, array, arguments[0], index, arguments[1])
        builder.store(arguments[2], builder.bitcast(place, OCTET.vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.none(array, index, value), build


@intrinsic  # type: ignore[untyped-decorator]
def ask_for(typing: Any, array: Any, index: Any, numbers: Any) -> Any:
    """Have the memory so many numbers behind this index brought near, if there is any; nothing waits for it.

    A processor has some sixteen such requests under way: worth it spread over work, not one right after another.
    """
    if not (isinstance(array, types.Array) and array.layout == "C" and isinstance(numbers, types.Integer)):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = place_of(context, builder, array, arguments[0], index, arguments[1])
        byte = ir.IntType(8).as_pointer()
        of = ir.FunctionType(ir.VoidType(), [byte, _INT, _INT, _INT])
        made = cgutils.get_or_insert_function(builder.module, of, "llvm.prefetch.p0i8")
        to_read, to_keep, data = (ir.Constant(_INT, number) for number in (0, 3, 1))
        there = builder.bitcast(builder.gep(place, [arguments[2]]), byte)
        builder.call(made, [there, to_read, to_keep, data])
        return context.get_dummy_value()

    return types.none(array, index, types.intp), build


# ---- arithmetic


def _spread(builder: Any, scalar: Any, kind: Any) -> Any:
    empty = ir.Constant(kind.vector, ir.Undefined)
    one = builder.insert_element(empty, scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(_INT, kind.lanes), [0] * kind.lanes))


def _common(*given: Any) -> Any:
    """The kind that an operation on these makes; None where that is not one."""
    kinds = {kind for kind in given if kind != types.float32}
    return kinds.pop() if len(kinds) == 1 and kinds <= {OCTET, SIXTEEN} else None


def _as(builder: Any, value: Any, given: Any, kind: Any) -> Any:
    """A number stands for as many."""
    return value if given is kind else _spread(builder, value, kind)


def _on_both(build: Callable[[Any, Any, Any], Any], given: tuple[Any, Any]) -> Any:
    """The code of an operation on two values."""
    common = _common(*given)

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pairs = zip(arguments, given, strict=True)
        return build(builder, *(_as(builder, value, kind, common) for value, kind in pairs))

    return code


_KINDS = (OCTET, SIXTEEN, types.float32)
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
    cases = [signature(kind, kind) for kind in (OCTET, SIXTEEN)]


@lower_builtin(operator.neg, OCTET)  # type: ignore[untyped-decorator]
@lower_builtin(operator.neg, SIXTEEN)  # type: ignore[untyped-decorator]
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
        if value not in (OCTET, SIXTEEN):
            return None
        return value(value), lambda context, builder, signature, arguments: build(
            builder, arguments[0], value
        )

    return operation


def _call(builder: Any, name: str, vector: Any, kind: Any) -> Any:
    of = ir.FunctionType(kind.vector, [kind.vector])
    made = cgutils.get_or_insert_function(builder.module, of, f"llvm.{name}.v{kind.lanes}f32")
    return builder.call(made, [vector])


def _shuffled(builder: Any, x: Any, y: Any, order: list[int]) -> Any:
    """Numbers of two octets in another order; those of the second count from 8."""
    return builder.shuffle_vector(x, y, ir.Constant(ir.VectorType(_INT, LANES), order))


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


@intrinsic  # type: ignore[untyped-decorator]
def spread(typing: Any, scalar: Any, like: Any) -> Any:
    """A number for every frame, as wide as another value."""
    if scalar != types.float32 or like not in (OCTET, SIXTEEN):
        return None
    return like(scalar, like), lambda context, builder, signature, arguments: _spread(
        builder, arguments[0], like
    )


@intrinsic  # type: ignore[untyped-decorator]
def is_any(typing: Any, mask: Any) -> Any:
    """Whether it is true for any of them."""
    if mask not in _MASKS.values():
        return None
    bits = ir.IntType(mask.lanes)

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.icmp_unsigned("!=", builder.bitcast(arguments[0], bits), ir.Constant(bits, 0))

    return types.boolean(mask), build


@intrinsic  # type: ignore[untyped-decorator]
def where(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """The first value where the mask is true, the second elsewhere."""
    common = _common(a, b, OCTET if mask is _MASKS[OCTET] else SIXTEEN)
    if mask not in _MASKS.values() or common is None or _MASKS[common] is not mask:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        x, y = _as(builder, arguments[1], a, common), _as(builder, arguments[2], b, common)
        return builder.select(arguments[0], x, y)

    return common(mask, a, b), build


@intrinsic  # type: ignore[untyped-decorator]
def behind(typing: Any, value: Any, first: Any) -> Any:
    """Each number's predecessor: `first`, then the first seven of an octet."""
    if not (value is OCTET and first == types.float32):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        before = _spread(builder, arguments[1], OCTET)
        return _shuffled(builder, arguments[0], before, [LANES, *range(LANES - 1)])

    return OCTET(value, first), build


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
                    parts[row] = _shuffled(builder, x, y, low)
                    parts[row + reach] = _shuffled(builder, x, y, high)
        return context.make_tuple(builder, signature.return_type, parts)

    return rows(rows), build


def blocks(frames: np.ndarray) -> np.ndarray:
    """Any number of frames in the last axis as whole octets, (n, ..., 8); the last frame is repeated to fill them."""
    short = -frames.shape[-1] % LANES
    filled = np.concatenate([frames, np.repeat(frames[..., -1:], short, -1)], -1) if short else frames
    cut = filled.reshape(*frames.shape[:-1], -1, LANES)
    return np.ascontiguousarray(np.moveaxis(cut, -2, 0), np.float32)
