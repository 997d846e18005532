"""The few per-channel steps of the kernels, written out for the channel count when it is compiled.

Sums over a tile's rows, or over a block's splats, have to stay in registers, and a loop over channels would put them in memory. The
count travels as the length of a tuple, so it is part of the compiled type.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.extending import intrinsic

from rtgs.renderer.cpu.simd import FLAGS, LANES, address, float_lanes, halves_added, repeat, uint16_lanes, vector_of

REGISTERS = 4  # that a channel of a block fills, one after the other (see `weights`)
SUMMED = 8  # numbers that a sum over a block is left in: to add up the rest waits until all blocks have been there


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


def _weights(builder: Any, context: Any, kind: Any, array: Any, index: Any) -> list[Any]:
    """The weights of a block's pixels, as lanes of uint16."""
    steps = (builder.add(index, index.type(LANES * q)) for q in range(REGISTERS))
    return [uint16_lanes(context, builder, kind, array, at) for at in steps]


def _pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    return builder.gep(context.make_array(kind)(context, builder, array).data, [index])


@intrinsic
def load_all(typingctx, registers, planes):
    """As many lanes as `registers` is long, one after the other."""
    lanes = types.UniTuple(float_lanes, registers.count)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero, step = context.get_constant(types.intp, 0), context.get_constant(types.intp, LANES)
        return context.make_tuple(builder, lanes, _planes(context, builder, sig.args[1], args[1], zero, step, lanes.count))

    return lanes(registers, planes), codegen


@intrinsic
def store_all(typingctx, planes, lanes):
    """The reverse of `load_all`."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        for k, register in enumerate(cgutils.unpack_tuple(builder, args[1])):
            at = context.get_constant(types.intp, LANES * k)
            builder.store(register, address(context, builder, sig.args[0], args[0], at), align=4)
        return context.get_dummy_value()

    return types.void(planes, lanes), codegen


@intrinsic
def add_weighted(typingctx, sums, weights, at, colors, color):
    """sums + weights[at …] · colors[color + c], for the registers of each channel c."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        old, index, new = cgutils.unpack_tuple(builder, args[0]), args[4], []
        w = _weights(builder, context, sig.args[1], args[1], args[2])
        for start in range(0, len(old), REGISTERS):
            color = repeat(builder, builder.load(_pointer(context, builder, sig.args[3], args[3], index)))
            for q in range(REGISTERS):
                new.append(builder.fadd(old[start + q], builder.fmul(w[q], color, flags=FLAGS), flags=FLAGS))
            index = builder.add(index, index.type(1))
        return context.make_tuple(builder, sig.return_type, new)

    return sums(sums, weights, types.intp, colors, types.intp), codegen


@intrinsic
def add_products(typingctx, sums, to, planes, weights, at):
    """sums[to + SUMMED · c …] += Σ weights[at …] · planes, over the registers of each channel c, down to `SUMMED` numbers."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        theirs, to = cgutils.unpack_tuple(builder, args[2]), args[1]
        w = _weights(builder, context, sig.args[3], args[3], args[4])
        for start in range(0, len(theirs), REGISTERS):
            product = builder.fmul(w[0], theirs[start], flags=FLAGS)
            for q in range(1, REGISTERS):
                product = builder.fadd(product, builder.fmul(w[q], theirs[start + q], flags=FLAGS), flags=FLAGS)
            product = halves_added(builder, product, SUMMED)
            place = builder.bitcast(_pointer(context, builder, sig.args[0], args[0], to), product.type.as_pointer())
            builder.store(builder.fadd(builder.load(place, align=4), product, flags=FLAGS), place, align=4)
            to = builder.add(to, to.type(SUMMED))
        return context.get_dummy_value()

    return types.void(sums, types.intp, planes, weights, types.intp), codegen
