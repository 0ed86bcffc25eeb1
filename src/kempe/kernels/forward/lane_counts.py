"""Lanes of random numbers, and counts of what falls into cells: the two ends of sampling in bulk.

The numbers are those of `random`: a function of a key and a counter. Counts are 32-bit numbers in
memory that several threads may share: each increment is one atomic instruction.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils

from kempe.kernels.base.vectors import DOUBLE, LANES, Vec, intrinsic

INT32 = ir.IntType(32)
INT64 = ir.IntType(64)
INTS = types.CPointer(types.int64)
STEP = 0x9E3779B97F4A7C15
MUL_A = 0xBF58476D1CE4E5B9
MUL_B = 0x94D049BB133111EB
"""The constants of SplitMix64 (Steele, Lea and Flood 2014)."""
ONE = 0x3FF0000000000000
"""The bits of 1.0: with 52 random bits behind them, a number in [1, 2)."""


def _spread(builder, value):
    """The vector of LANES integers `value`."""
    vector = ir.Constant(ir.VectorType(INT64, LANES), ir.Undefined)
    for lane in range(LANES):
        vector = builder.insert_element(vector, value, ir.Constant(INT32, lane))
    return vector


@intrinsic
def units(typingctx, key, counter):
    """Numbers in [0, 1), of 52 bits: those of the sequence from `key` at counter, counter + 1, ...
    one a lane.
    """

    def codegen(context, builder, sig, args):
        vector = ir.VectorType(INT64, LANES)

        def constant(number):
            return ir.Constant(vector, [number] * LANES)

        key, counter = (_spread(builder, x) for x in args)
        at = builder.add(counter, ir.Constant(vector, list(range(1, LANES + 1))))
        z = builder.add(key, builder.mul(at, constant(STEP)))
        z = builder.mul(builder.xor(z, builder.lshr(z, constant(30))), constant(MUL_A))
        z = builder.mul(builder.xor(z, builder.lshr(z, constant(27))), constant(MUL_B))
        z = builder.xor(z, builder.lshr(z, constant(31)))
        z = builder.or_(builder.lshr(z, constant(12)), constant(ONE))
        floats = ir.VectorType(DOUBLE, LANES)
        return builder.fsub(builder.bitcast(z, floats), ir.Constant(floats, [1.0] * LANES))

    return Vec(LANES)(types.int64, types.int64), codegen


@intrinsic
def rounded_down(typingctx, value):
    """The largest whole number that is not above each entry of a vector."""

    def codegen(context, builder, sig, args):
        kind = args[0].type
        name = f"llvm.floor.v{kind.count}f64"
        floor = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), name)
        return builder.call(floor, [args[0]])

    return value(value), codegen


def _place(builder, pointer, index):
    """Where the 32-bit number `index` lies."""
    return builder.gep(builder.bitcast(pointer, INT32.as_pointer()), [index])


@intrinsic
def will_count(typingctx, pointer, index):
    """Have the memory of count `index` brought near."""

    def codegen(context, builder, sig, args):
        bytes_ = ir.IntType(8).as_pointer()
        call = ir.FunctionType(ir.VoidType(), [bytes_, INT32, INT32, INT32])
        prefetch = cgutils.get_or_insert_function(builder.module, call, "llvm.prefetch.p0")
        how = [ir.Constant(INT32, x) for x in (1, 3, 1)]  # to be written, often, data
        builder.call(prefetch, [builder.bitcast(_place(builder, *args), bytes_), *how])
        return context.get_dummy_value()

    return types.void(INTS, types.int64), codegen


@intrinsic
def count_one(typingctx, pointer, index):
    """Add 1 to the 32-bit count `index`, whatever other threads do."""

    def codegen(context, builder, sig, args):
        builder.atomic_rmw("add", _place(builder, *args), ir.Constant(INT32, 1), "monotonic")
        return context.get_dummy_value()

    return types.void(INTS, types.int64), codegen
