"""The few per-channel steps of the reverse kernels, written out for the channel count when it is compiled.

Sums over a tile's rows have to stay in registers, and a loop over channels would put them in memory. The count travels as the
length of a tuple, so it is part of the compiled type.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.extending import intrinsic

from rtgs.render.cpu.simd import FLAGS, address, float_lanes, repeat, vector_of


def _planes(context: Any, builder: Any, kind: Any, array: Any, index: Any, step: Any, count: int) -> list[Any]:
    """`count` loads, `step` numbers apart."""
    out = []
    for _ in range(count):
        out.append(builder.load(address(context, builder, kind, array, index), align=4))
        index = builder.add(index, step)
    return out


@intrinsic
def no_lanes(typingctx, channels):
    """A tuple of C zero lanes; `channels` is a tuple of length C."""
    sums = types.UniTuple(float_lanes, channels.count)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(vector_of(float_lanes), [ir.Constant(ir.FloatType(), 0.0)] * 16)
        return context.make_tuple(builder, sums, [zero] * channels.count)

    return sums(channels), codegen


@intrinsic
def add_scaled(typingctx, sums, weight, planes, index, step):
    """sums[q] + weight · planes[index + q·step …] for each channel q."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        old = cgutils.unpack_tuple(builder, args[0])
        loaded = _planes(context, builder, sig.args[2], args[2], args[3], args[4], len(old))
        new = [builder.fadd(s, builder.fmul(args[1], g, flags=FLAGS), flags=FLAGS) for s, g in zip(old, loaded, strict=True)]
        return context.make_tuple(builder, sig.return_type, new)

    return sums(sums, float_lanes, planes, types.intp, types.intp), codegen


@intrinsic
def weighted_sum(typingctx, channels, start, planes, index, step, splats, at):
    """start + Σ_q splats[at + q] · planes[index + q·step …]."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _, total, array, index, step, rows, at = args
        data = context.make_array(sig.args[5])(context, builder, rows).data
        for plane in _planes(context, builder, sig.args[2], array, index, step, channels.count):
            color = repeat(builder, builder.load(builder.gep(data, [at])))
            total = builder.fadd(total, builder.fmul(color, plane, flags=FLAGS), flags=FLAGS)
            at = builder.add(at, at.type(1))
        return total

    return float_lanes(channels, float_lanes, planes, types.intp, types.intp, splats, types.intp), codegen
