"""Eight numbers at once in compiled loops: the eight frames of a chunk as one register.

Numba leaves it to LLVM to see that a loop over eight frames could run side by side, and with dozens of arrays in the
loop LLVM gives up. An `Octet` says it: arithmetic on it is arithmetic on a vector of eight float32, on any processor
(two registers where they hold four). With `exact` nothing is reordered or fused, so that a number does not depend on
its neighbours, nor on the processor.

Compiled functions only: `exact` ones are called from Python and kept by numba between runs, `inner` ones are parts of
them (numba looks at the file of the `exact` one alone: delete `__pycache__` after changing an `inner` one elsewhere).
Octets live in the last axis of C-contiguous float32 arrays of length 8:

    x = load(turns, (row, joint, 1))              # turns[row, joint, 1, :]
    store(turns, (row, joint, 1), where(x < ZERO, -x, x))
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

exact = functools.partial(njit, cache=True, nogil=True, error_model="numpy")  # as written, in this order
inner = functools.partial(njit, error_model="numpy")  # a part of those, compiled with them
LANES = 8
_FLOATS, _BITS = ir.VectorType(ir.FloatType(), LANES), ir.VectorType(ir.IntType(1), LANES)
_INT = ir.IntType(32)


class _OctetType(types.Type):  # type: ignore[misc]
    """Eight float32."""

    def __init__(self) -> None:
        super().__init__(name="Octet")


class _MaskType(types.Type):  # type: ignore[misc]
    """Eight truths."""

    def __init__(self) -> None:
        super().__init__(name="OctetMask")


OCTET, MASK = _OctetType(), _MaskType()


@register_model(_OctetType)
class _OctetModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _FLOATS)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _BITS)


def _place(context: Any, builder: Any, array_type: Any, array: Any, index_type: Any, index: Any) -> Any:
    """Pointer to the octet at this index."""
    indices = cgutils.unpack_tuple(builder, index)
    indices = [context.cast(builder, i, t, types.intp) for i, t in zip(indices, index_type, strict=True)]
    indices.append(ir.Constant(indices[0].type, 0))
    view = context.make_array(array_type)(context, builder, array)
    first = cgutils.get_item_pointer(context, builder, array_type, view, indices, wraparound=False)
    return builder.bitcast(first, _FLOATS.as_pointer())


def _holds_octets(array: Any, index: Any) -> bool:
    return (
        isinstance(array, types.Array)
        and array.dtype == types.float32
        and array.layout == "C"
        and isinstance(index, types.BaseTuple)
        and array.ndim == len(index) + 1
    )


@intrinsic  # type: ignore[untyped-decorator]
def load(typing: Any, array: Any, index: Any) -> Any:
    """`array[*index, 0:8]`."""
    if not _holds_octets(array, index):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, array, arguments[0], index, arguments[1])
        return builder.load(place, align=4)

    return OCTET(array, index), build


@intrinsic  # type: ignore[untyped-decorator]
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """`array[*index, 0:8] = value`."""
    if not (_holds_octets(array, index) and value is OCTET):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, array, arguments[0], index, arguments[1])
        builder.store(arguments[2], place, align=4)
        return context.get_dummy_value()

    return types.none(array, index, value), build


def _spread(builder: Any, scalar: Any) -> Any:
    empty = ir.Constant(_FLOATS, ir.Undefined)
    one = builder.insert_element(empty, scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(_INT, LANES), [0] * LANES))


def _on_both(build: Callable[[Any, Any, Any], Any], kinds: tuple[Any, Any]) -> Any:
    """The code of an operation on two octets, one of which may be a scalar."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pairs = zip(arguments, kinds, strict=True)
        return build(builder, *(v if kind is OCTET else _spread(builder, v) for v, kind in pairs))

    return code


_PAIRS = ((OCTET, OCTET), (OCTET, types.float32), (types.float32, OCTET))


def _define(operation: Callable[..., Any], result: Any, build: Callable[[Any, Any, Any], Any]) -> None:
    """An operator; as a template and not as an overload, which would be a function to inline at every use."""
    infer_global(operation)(
        type("_Template", (ConcreteTemplate,), {"cases": [signature(result, *pair) for pair in _PAIRS]})
    )
    for pair in _PAIRS:
        lower_builtin(operation, *pair)(_on_both(build, pair))


_define(operator.add, OCTET, lambda builder, x, y: builder.fadd(x, y))
_define(operator.iadd, OCTET, lambda builder, x, y: builder.fadd(x, y))
_define(operator.sub, OCTET, lambda builder, x, y: builder.fsub(x, y))
_define(operator.mul, OCTET, lambda builder, x, y: builder.fmul(x, y))
_define(operator.truediv, OCTET, lambda builder, x, y: builder.fdiv(x, y))
_define(operator.lt, MASK, lambda builder, x, y: builder.fcmp_ordered("<", x, y))
_define(operator.gt, MASK, lambda builder, x, y: builder.fcmp_ordered(">", x, y))


@infer_global(operator.neg)
class _Negative(ConcreteTemplate):  # type: ignore[misc]
    cases = [signature(OCTET, OCTET)]


@lower_builtin(operator.neg, OCTET)  # type: ignore[untyped-decorator]
def _negative(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return builder.fneg(arguments[0])


def _chosen(sign: str) -> Any:
    """The first where it compares so with the second, which stands where they cannot be compared."""

    @intrinsic  # type: ignore[untyped-decorator]
    def operation(typing: Any, a: Any, b: Any) -> Any:
        if (a, b) not in _PAIRS:
            return None
        return OCTET(a, b), _on_both(
            lambda builder, x, y: builder.select(builder.fcmp_ordered(sign, x, y), x, y), (a, b)
        )

    return operation


least, most = _chosen("<"), _chosen(">")


def _of_one(result: Any, kind: Any, build: Callable[[Any, Any], Any]) -> Any:
    @intrinsic  # type: ignore[untyped-decorator]
    def operation(typing: Any, value: Any) -> Any:
        if value is not kind:
            return None
        return result(value), lambda context, builder, signature, arguments: build(builder, arguments[0])

    return operation


def _call(builder: Any, name: str, vector: Any) -> Any:
    kind = ir.FunctionType(_FLOATS, [_FLOATS])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v8f32"), [vector])


root = _of_one(OCTET, OCTET, lambda builder, x: _call(builder, "sqrt", x))
size = _of_one(OCTET, OCTET, lambda builder, x: _call(builder, "fabs", x))
spread = _of_one(OCTET, types.float32, _spread)
is_any = _of_one(
    types.boolean,
    MASK,
    lambda builder, x: builder.icmp_unsigned(
        "!=", builder.bitcast(x, ir.IntType(LANES)), ir.Constant(ir.IntType(LANES), 0)
    ),
)


@intrinsic  # type: ignore[untyped-decorator]
def where(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """The first value where the mask is true, the second elsewhere."""
    if not (mask is MASK and a is OCTET and b is OCTET):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.select(*arguments)

    return OCTET(mask, a, b), build


@intrinsic  # type: ignore[untyped-decorator]
def behind(typing: Any, value: Any, first: Any) -> Any:
    """Each number's predecessor: `first`, then the first seven."""
    if not (value is OCTET and first == types.float32):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        order = ir.Constant(ir.VectorType(_INT, LANES), [LANES, *range(LANES - 1)])
        return builder.shuffle_vector(arguments[0], _spread(builder, arguments[1]), order)

    return OCTET(value, first), build


def blocks(frames: np.ndarray) -> np.ndarray:
    """Any number of frames in the last axis as whole octets, (n, ..., 8); the last frame is repeated to fill them."""
    short = -frames.shape[-1] % LANES
    filled = np.concatenate([frames, np.repeat(frames[..., -1:], short, -1)], -1) if short else frames
    cut = filled.reshape(*frames.shape[:-1], -1, LANES)
    return np.ascontiguousarray(np.moveaxis(cut, -2, 0), np.float32)
