"""Sixteen numbers of one row at once, for sums over rows that may be kept in half the space.

Where a loop's order does not matter LLVM finds such vectors itself, of eight; told so, it takes sixteen, keeps them in
registers, and can be given float16, which numba knows on graphics cards only. Halves are seen as uint16
(`array.view(np.uint16)`). Unlike those of `octet`, these numbers may be fused, so they may differ between processors
in the last bit. Compiled functions only.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .compiled import HALF, NOTHING, ONE, ZERO, F
from .octet import SIXTEEN, inner, least, most, place_of, size

WIDE = SIXTEEN.lanes
_WHOLE, _HALVES = ir.VectorType(ir.IntType(32), WIDE), ir.VectorType(ir.HalfType(), WIDE)


@intrinsic  # type: ignore[untyped-decorator]
def wide(typing: Any, array: Any, index: Any) -> Any:
    """Sixteen numbers of an array (float32, or halves) from this index on along its last axis."""
    if not (isinstance(array, types.Array) and array.dtype in (types.float32, types.uint16)):
        return None
    if array.layout == "F" or not isinstance(index, types.BaseTuple) or array.ndim != len(index):
        return None
    is_half = array.dtype == types.uint16

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        of = _HALVES if is_half else SIXTEEN.vector
        place = place_of(context, builder, array, arguments[0], index, arguments[1])
        numbers = builder.load(builder.bitcast(place, of.as_pointer()), align=2 if is_half else 4)
        return builder.fpext(numbers, SIXTEEN.vector) if is_half else numbers

    return SIXTEEN(array, index), build


@intrinsic  # type: ignore[untyped-decorator]
def put(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Sixteen numbers into a float32 array, from this index on."""
    if not (isinstance(array, types.Array) and array.dtype == types.float32 and value is SIXTEEN):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = place_of(context, builder, array, arguments[0], index, arguments[1])
        builder.store(arguments[2], builder.bitcast(place, SIXTEEN.vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.none(array, index, value), build


@intrinsic  # type: ignore[untyped-decorator]
def with_product(typing: Any, total: Any, share: Any, value: Any) -> Any:
    """`total + share * value` with a number for `share`; in one operation where the processor has it."""
    if not (total is SIXTEEN and value is SIXTEEN and share == types.float32):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        start, scalar, numbers = arguments
        empty = ir.Constant(SIXTEEN.vector, ir.Undefined)
        one = builder.insert_element(empty, scalar, ir.Constant(ir.IntType(32), 0))
        spread = builder.shuffle_vector(one, empty, ir.Constant(_WHOLE, [0] * WIDE))
        kind = ir.FunctionType(SIXTEEN.vector, [SIXTEEN.vector] * 3)
        fused = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fmuladd.v{WIDE}f32")
        return builder.call(fused, [spread, numbers, start])

    return SIXTEEN(total, share, value), build


@intrinsic  # type: ignore[untyped-decorator]
def total(typing: Any, value: Any) -> Any:
    """The sum of all sixteen."""
    if value is not SIXTEEN:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.FloatType(), [ir.FloatType(), SIXTEEN.vector])
        added = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.fadd.v{WIDE}f32")
        return builder.call(added, [ir.Constant(ir.FloatType(), -0.0), arguments[0]], fastmath=("reassoc",))

    return types.float32(value), build


@intrinsic  # type: ignore[untyped-decorator]
def highest(typing: Any, value: Any) -> Any:
    """The largest of all sixteen, none of which may be NaN."""
    if value is not SIXTEEN:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.FloatType(), [SIXTEEN.vector])
        largest = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.fmax.v{WIDE}f32")
        return builder.call(largest, [arguments[0]], fastmath=("nnan",))

    return types.float32(value), build


@intrinsic  # type: ignore[untyped-decorator]
def _floor(typing: Any, value: Any) -> Any:
    if value is not SIXTEEN:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(SIXTEEN.vector, [SIXTEEN.vector])
        floor = cgutils.get_or_insert_function(builder.module, kind, f"llvm.floor.v{WIDE}f32")
        return builder.call(floor, [arguments[0]])

    return SIXTEEN(value), build


@intrinsic  # type: ignore[untyped-decorator]
def _two_to(typing: Any, whole: Any) -> Any:
    """Powers of two, written as a float's exponent bits."""
    if whole is not SIXTEEN:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        exponent = builder.add(builder.fptosi(arguments[0], _WHOLE), ir.Constant(_WHOLE, [127] * WIDE))
        return builder.bitcast(builder.shl(exponent, ir.Constant(_WHOLE, [23] * WIDE)), SIXTEEN.vector)

    return SIXTEEN(whole), build


@inner()
def exponentials(x):  # type: ignore[no-untyped-def]
    """e^x of sixteen numbers, as `compiled.exponential`."""
    y = least(most(x * F(1.442695041), F(-126.0)), F(126.0))
    whole = _floor(y + HALF)
    r = (y - whole) * F(0.6931471806)
    p = r * (F(0.5) + r * (F(1 / 6) + r * (F(1 / 24) + r * (F(1 / 120) + r * F(1 / 720))))) + ONE
    return (r * p + ONE) * _two_to(whole)


@inner()
def gelus(x):  # type: ignore[no-untyped-def]
    """Sixteen numbers times the normal distribution's share below them, as `compiled.gelu`."""
    far = size(x)
    z = far * F(0.7071067812)
    t = ONE / (z * F(0.3275911) + ONE)
    p = t * (
        t * (t * (t * (t * F(1.061405429) - F(1.453152027)) + F(1.421413741)) - F(0.284496736))
        + F(0.254829592)
    )
    return most(x, ZERO) - far * HALF * p * most(exponentials(-(z * z)) - NOTHING, ZERO)


@intrinsic  # type: ignore[untyped-decorator]
def narrowed(typing: Any, number: Any) -> Any:
    """The half nearest to a float32, its 16 bits; infinite beyond 65504."""
    if number != types.float32:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(builder.fptrunc(arguments[0], ir.HalfType()), ir.IntType(16))

    return types.uint16(number), build


@intrinsic  # type: ignore[untyped-decorator]
def widened(typing: Any, bits: Any) -> Any:
    """The float32 that the 16 bits of a half stand for."""
    if bits != types.uint16:
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fpext(builder.bitcast(arguments[0], ir.HalfType()), ir.FloatType())

    return types.float32(bits), build
