"""Sixteen numbers in one register: an explicit vector type for the kernels.

LLVM turns a plain inner loop into vectors only when nothing disturbs it (a call, a branch, an array it cannot prove separate), and
then keeps its sums in memory. `Lanes` says it outright: a value of sixteen lanes that lives in registers, with the usual
operators. LLVM splits it for narrower machines: one AVX-512 register, two of AVX2, four of NEON.

In compiled code only. A scalar beside lanes is repeated in each; a comparison gives a mask for `where`; products and sums are
fused where the machine can.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.extending import intrinsic, register_model
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

from rtgs.base.compiled import inlined

LANES = 16
FLAGS = ("contract", "nsz")  # a·b + c may be fused, −0 is 0; sums keep their order and NaN stays NaN


class LanesType(types.Type):
    """Sixteen of `dtype`; booleans are a mask."""

    def __init__(self, dtype: types.Type) -> None:
        self.dtype = dtype
        super().__init__(name=f"Lanes({dtype})")


float_lanes = LanesType(types.float32)
double_lanes = LanesType(types.float64)
int_lanes = LanesType(types.int32)
mask_lanes = LanesType(types.boolean)

_ELEMENT = {
    types.float32: ir.FloatType(),
    types.float64: ir.DoubleType(),
    types.int32: ir.IntType(32),
    types.uint16: ir.IntType(16),
    types.boolean: ir.IntType(1),
}


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: LanesType) -> None:
        super().__init__(manager, lanes, ir.VectorType(_ELEMENT[lanes.dtype], LANES))


def vector_of(lanes: LanesType) -> ir.VectorType:
    return ir.VectorType(_ELEMENT[lanes.dtype], LANES)


def repeat(builder: Any, scalar: Any) -> Any:
    vector = ir.VectorType(scalar.type, LANES)
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), None))


def _as_lanes(context: Any, builder: Any, value: Any, source: types.Type, lanes: LanesType) -> Any:
    if isinstance(source, LanesType):
        return value
    return repeat(builder, context.cast(builder, value, source, lanes.dtype))


def _call(builder: Any, name: str, result: Any, *arguments: Any) -> Any:
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, [a.type for a in arguments]), name)
    return builder.call(function, arguments)


def _suffix(lanes: LanesType) -> str:
    return {types.float32: "v16f32", types.float64: "v16f64", types.int32: "v16i32"}[lanes.dtype]


# --- operators -------------------------------------------------------------------------------------


def _numeric(kind: types.Type) -> bool:
    return isinstance(kind, LanesType | types.Float | types.Integer)


def _define_operator(op: Callable[..., Any], emit: Callable[[Any, Any, Any, LanesType], Any], compares: bool) -> None:
    @infer_global(op)
    class _Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            lanes = [a for a in args if isinstance(a, LanesType)]
            if len(args) != 2 or kws or not lanes or not all(map(_numeric, args)) or any(l != lanes[0] for l in lanes):
                return None
            return signature(mask_lanes if compares else lanes[0], *args)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        lanes = next(a for a in sig.args if isinstance(a, LanesType))
        a, b = (_as_lanes(context, builder, v, t, lanes) for v, t in zip(args, sig.args, strict=True))
        return emit(builder, a, b, lanes)

    for kinds in ((LanesType, LanesType), (LanesType, types.Number), (types.Number, LanesType)):
        lower_builtin(op, *kinds)(lower)


def _arithmetic(name: str) -> Callable[[Any, Any, Any, LanesType], Any]:
    def emit(builder: Any, a: Any, b: Any, lanes: LanesType) -> Any:
        if lanes == mask_lanes:
            raise TypeError("masks have no arithmetic")
        if lanes == int_lanes:
            return getattr(builder, name)(a, b)
        return getattr(builder, f"f{name}")(a, b, flags=FLAGS)

    return emit


def _comparison(symbol: str) -> Callable[[Any, Any, Any, LanesType], Any]:
    def emit(builder: Any, a: Any, b: Any, lanes: LanesType) -> Any:
        if lanes == int_lanes:
            return builder.icmp_signed(symbol, a, b)
        return builder.fcmp_ordered(symbol, a, b)

    return emit


for _op, _name in ((operator.add, "add"), (operator.sub, "sub"), (operator.mul, "mul"), (operator.truediv, "div")):
    _define_operator(_op, _arithmetic(_name), compares=False)
for _op, _symbol in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _define_operator(_op, _comparison(_symbol), compares=True)
_define_operator(operator.and_, lambda builder, a, b, lanes: builder.and_(a, b), compares=False)
_define_operator(operator.or_, lambda builder, a, b, lanes: builder.or_(a, b), compares=False)


@infer_global(operator.neg)
class _Negation(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(args[0], args[0]) if isinstance(args[0], LanesType) else None


@lower_builtin(operator.neg, LanesType)
def _negate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0])


# --- functions -------------------------------------------------------------------------------------


def address(context: Any, builder: Any, kind: types.Array, array: Any, index: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector_of(LanesType(kind.dtype)).as_pointer())


@intrinsic
def load(typingctx, array, index):
    """Sixteen numbers of a contiguous float array from the flat `index` on. Bounds are the caller's."""
    lanes = LanesType(array.dtype)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = address(context, builder, sig.args[0], args[0], args[1])
        return builder.load(pointer, align=sig.args[0].dtype.bitwidth // 8)

    return lanes(array, types.intp), codegen


@intrinsic
def store(typingctx, array, index, value):
    """Write lanes into a contiguous array from the flat `index` on."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = address(context, builder, sig.args[0], args[0], args[1])
        builder.store(args[2], pointer, align=sig.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, LanesType(array.dtype)), codegen


@intrinsic
def copy_half(typingctx, to, to_index, array, index):
    """Half a register's numbers from one contiguous array's flat index to another's of the same kind. Bounds are the caller's."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        half = ir.VectorType(context.get_data_type(array.dtype), LANES // 2).as_pointer()
        source, target = (
            builder.bitcast(builder.gep(context.make_array(kind)(context, builder, a).data, [i]), half)
            for kind, a, i in ((sig.args[2], args[2], args[3]), (sig.args[0], args[0], args[1]))
        )
        align = array.dtype.bitwidth // 8
        builder.store(builder.load(source, align=align), target, align=align)
        return context.get_dummy_value()

    return types.void(to, types.intp, array, types.intp), codegen


def uint16_lanes(context: Any, builder: Any, kind: types.Array, array: Any, index: Any) -> Any:
    """Sixteen numbers of a contiguous uint16 array, as float32."""
    short = builder.load(address(context, builder, kind, array, index), align=2)
    return builder.sitofp(builder.zext(short, vector_of(int_lanes)), vector_of(float_lanes))


@intrinsic
def store_uint16(typingctx, array, index, value):
    """Write float32 lanes in [0, 65536) into a contiguous uint16 array, rounded towards zero."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = builder.fptosi(args[2], vector_of(int_lanes))
        short = builder.trunc(whole, ir.VectorType(ir.IntType(16), LANES))
        builder.store(short, address(context, builder, sig.args[0], args[0], args[1]), align=2)
        return context.get_dummy_value()

    return types.void(types.Array(types.uint16, 1, "C"), types.intp, float_lanes), codegen


@intrinsic
def take_next(typingctx, counter):
    """The counter's number, which is then raised by one: of `[1]` int64, shared between threads.

    Threads that draw their work so end together, whatever slows one of them: another job, or a slower core.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", data, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counter), codegen


@intrinsic
def prefetch(typingctx, array, index):
    """Ask for the cache line of the flat `index`; any index is allowed."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        address = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        i32 = ir.IntType(32)
        name = "llvm.prefetch.p0" if str(address.type) == "ptr" else "llvm.prefetch.p0i8"
        _call(builder, name, ir.VoidType(), address, *(ir.Constant(i32, v) for v in (0, 3, 1)))
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen


@intrinsic
def lanes_of(typingctx, scalar):
    """A float32 in every lane."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return repeat(builder, context.cast(builder, args[0], sig.args[0], types.float32))

    return float_lanes(scalar), codegen


@intrinsic
def lane_numbers(typingctx):
    """0, 1, … 15 as float32."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return ir.Constant(vector_of(float_lanes), [ir.Constant(ir.FloatType(), float(k)) for k in range(LANES)])

    return float_lanes(), codegen


@intrinsic
def where(typingctx, mask, a, b):
    """Lane by lane a or b; one of them may be a scalar."""
    lanes = a if isinstance(a, LanesType) else b

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        x, y = (_as_lanes(context, builder, v, t, lanes) for v, t in zip(args[1:], sig.args[1:], strict=True))
        return builder.select(args[0], x, y)

    return lanes(mask_lanes, a, b), codegen


def _of_two(name: str) -> Any:
    @intrinsic
    def function(typingctx, a, b):
        lanes = a if isinstance(a, LanesType) else b

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            x, y = (_as_lanes(context, builder, v, t, lanes) for v, t in zip(args, sig.args, strict=True))
            # What one instruction does: the second operand wins when either is NaN.
            return builder.select(builder.fcmp_ordered(name, x, y), x, y)

        return lanes(a, b), codegen

    return function


minimum = _of_two("<")
maximum = _of_two(">")


def _of_one(name: str) -> Any:
    @intrinsic
    def function(typingctx, a):
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return _call(builder, f"llvm.{name}.{_suffix(a)}", vector_of(a), args[0])

        return a(a), codegen

    return function


square_root = _of_one("sqrt")
magnitude = _of_one("fabs")
floor = _of_one("floor")
ceil = _of_one("ceil")


@intrinsic
def negative_magnitude(typingctx, a):
    """−|a|: sets the sign bit."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        ints = vector_of(int_lanes)
        bits = builder.bitcast(args[0], ints)
        sign = ir.Constant(ints, [ir.Constant(ir.IntType(32), -(2**31))] * LANES)
        return builder.bitcast(builder.or_(bits, sign), vector_of(float_lanes))

    return float_lanes(float_lanes), codegen


@intrinsic
def narrow(typingctx, a):
    """float64 lanes as float32."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.fptrunc(args[0], vector_of(float_lanes))

    return float_lanes(double_lanes), codegen


@intrinsic
def widen(typingctx, a):
    """float32 lanes as float64."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.fpext(args[0], vector_of(double_lanes))

    return double_lanes(float_lanes), codegen


@intrinsic
def any_lane(typingctx, mask):
    """Whether the mask holds anywhere."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(mask_lanes), codegen


@intrinsic
def mask_bits(typingctx, mask):
    """The mask as an integer, lane k in bit k."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), ir.IntType(64))

    return types.int64(mask_lanes), codegen


@intrinsic
def lowest_bit(typingctx, bits):
    """Number of the lowest bit that is set; `bits` is not 0."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, "llvm.cttz.i64", ir.IntType(64), args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen


def halves_added(builder: Any, vector: Any, width: int) -> Any:
    """The upper half of the lanes added to the lower one, again and again until `width` of them are left."""
    left = LANES
    while left > width:
        left //= 2
        index = ir.VectorType(ir.IntType(32), left)
        low, high = (
            builder.shuffle_vector(
                vector,
                ir.Constant(vector.type, ir.Undefined),
                ir.Constant(index, [ir.Constant(ir.IntType(32), k + first) for k in range(left)]),
            )
            for first in (0, left)
        )
        vector = builder.fadd(low, high, flags=FLAGS)
    return vector


@intrinsic
def total(typingctx, a):
    """Sum over the lanes, as a balanced tree: the same for every machine."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(halves_added(builder, args[0], 1), ir.Constant(ir.IntType(32), 0))

    return a.dtype(a), codegen


@intrinsic
def truncate_to_int(typingctx, a):
    """Towards zero; a lane beyond int32 is undefined."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.fptosi(args[0], vector_of(int_lanes))

    return int_lanes(float_lanes), codegen


@intrinsic
def to_float(typingctx, a):
    """int32 lanes as float32."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.sitofp(args[0], vector_of(float_lanes))

    return float_lanes(int_lanes), codegen


@intrinsic
def scale_by_power_of_two(typingctx, a, n):
    """a · 2ⁿ by adding n to the exponent's bits: exact while the result is a normal number."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        ints = vector_of(int_lanes)
        shifted = builder.shl(args[1], ir.Constant(ints, [ir.Constant(ir.IntType(32), 23)] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(args[0], ints), shifted), vector_of(float_lanes))

    return float_lanes(float_lanes, int_lanes), codegen


@intrinsic
def exponent(typingctx, a):
    """⌊log₂ a⌋ of a positive normal number, as float32."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        ints = vector_of(int_lanes)
        bits = builder.lshr(builder.bitcast(args[0], ints), ir.Constant(ints, [ir.Constant(ir.IntType(32), 23)] * LANES))
        bits = builder.sub(bits, ir.Constant(ints, [ir.Constant(ir.IntType(32), 127)] * LANES))
        return builder.sitofp(bits, vector_of(float_lanes))

    return float_lanes(float_lanes), codegen


@intrinsic
def mantissa(typingctx, a):
    """a / 2^exponent(a), in [1, 2)."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        ints = vector_of(int_lanes)
        bits = builder.bitcast(args[0], ints)
        bits = builder.and_(bits, ir.Constant(ints, [ir.Constant(ir.IntType(32), 0x007FFFFF)] * LANES))
        bits = builder.or_(bits, ir.Constant(ints, [ir.Constant(ir.IntType(32), 0x3F800000)] * LANES))
        return builder.bitcast(bits, vector_of(float_lanes))

    return float_lanes(float_lanes), codegen


# --- built of these --------------------------------------------------------------------------------

# 2^f by Chebyshev interpolation: degree 5 on [−1, 0], relative error 1.0e-7; degree 6 on [−½, ½], 2.6e-9.
_BELOW = (0.999999943886743, 0.6931431346411128, 0.24017895627762786, 0.05529811967633441, 0.009209180357198327, 0.0009468770291)
_ABOUT = (1.0, 0.6931472067028327, 0.24022650922288527, 0.0555032722667, 0.009618056678554, 0.00134004281775, 0.000154614447)
_LOG2_E = 1.4426950408889634


@inlined
def exp2_below_one(t):
    """2^t for −126 < t ≤ 0; other lanes are undefined, not trapped."""
    n = truncate_to_int(t)
    f = t - to_float(n)
    p = ((((_BELOW[5] * f + _BELOW[4]) * f + _BELOW[3]) * f + _BELOW[2]) * f + _BELOW[1]) * f + _BELOW[0]
    return scale_by_power_of_two(p, n)


@inlined
def exponential(x):
    """e^x, float32: held within the normal numbers, 1e-38 to 1e38."""
    t = minimum(maximum(x * _LOG2_E, -126.0), 126.0)
    n = floor(t + 0.5)
    f = t - n
    p = (((((_ABOUT[6] * f + _ABOUT[5]) * f + _ABOUT[4]) * f + _ABOUT[3]) * f + _ABOUT[2]) * f + _ABOUT[1]) * f + _ABOUT[0]
    return scale_by_power_of_two(p, truncate_to_int(n))


@inlined
def log2(a):
    """log₂ of positive normal numbers: exponent, and the artanh series of the mantissa within [1/√2, √2]; 1e-7 absolute below 8."""
    e, m = exponent(a), mantissa(a)
    high = m > 1.4142135
    e, m = where(high, e + 1.0, e), where(high, m * 0.5, m)
    t = (m - 1.0) / (m + 1.0)
    t2 = t * t
    series = 1.0 + t2 * (1.0 / 3.0 + t2 * (1.0 / 5.0 + t2 * (1.0 / 7.0 + t2 * (1.0 / 9.0))))
    return e + (2.0 * _LOG2_E) * (t * series)
