"""Eight numbers at once in compiled loops: the eight frames of a chunk as one register, or those of two sessions.

Numba leaves it to LLVM to see that a loop over eight frames could run side by side, and with dozens of arrays in the
loop LLVM gives up. An `Octet` says it: arithmetic on it is arithmetic on a vector of eight float32, on any processor
(two registers where they hold four). With `exact` nothing is reordered, and a product and a sum are rounded once only
where `fused` says so, so that a number does not depend on its neighbours, nor on the processor.

Compiled functions only: `exact` ones are called from Python and kept by numba between runs, `inner` ones are parts of
them (numba looks at the file of the `exact` one alone: delete `__pycache__` after changing an `inner` one elsewhere).
What stands in arrays is read and written by `rows`, for one session or for two at once: an octet, or a pair of them.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

exact = functools.partial(njit, cache=True, nogil=True, error_model="numpy")  # as written, in this order
inner = functools.partial(njit, error_model="numpy", forceinline=True)  # a part of those, compiled into them
LANES = 8
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


# ---- arithmetic


def joined(builder: Any, parts: list[Any]) -> Any:
    """Octets side by side."""
    if len(parts) == 1:
        return parts[0]
    order = ir.Constant(ir.VectorType(_INT, 2 * LANES), list(range(2 * LANES)))
    return builder.shuffle_vector(*parts, order)


def spread_by(builder: Any, scalar: Any, kind: Any) -> Any:
    """A number for every frame."""
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
    return spread_by(builder, value, kind) if given == types.float32 else joined(builder, [value, value])


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
        return value(value), lambda context, builder, signature, arguments: build(
            builder, arguments[0], value
        )

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
    return like(scalar, like), lambda context, builder, signature, arguments: spread_by(
        builder, arguments[0], like
    )


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
