"""One number from all entries of a vector: their sum, their largest, and where it stands."""

from __future__ import annotations

from llvmlite import ir
from numba import types

from kempe.kernels.base.vectors import INT64, LANES, Vec, intrinsic


def _halves(builder, value):
    """The lower and the upper half of a vector."""
    width = value.type.count // 2
    for start in (0, width):
        order = ir.Constant(ir.VectorType(ir.IntType(32), width), list(range(start, start + width)))
        yield builder.shuffle_vector(value, value, order)


def _reduced(builder, value, join):
    """The entry that is left after joining halves."""
    while value.type.count > 1:
        value = join(*_halves(builder, value))
    return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))


@intrinsic
def total(typingctx, vector):
    """The sum of a vector's entries, halves added first."""

    def codegen(context, builder, sig, args):
        return _reduced(builder, args[0], builder.fadd)

    return types.float64(vector), codegen


@intrinsic
def largest(typingctx, vector):
    """The largest of a vector's entries; anything where one is NaN."""

    def codegen(context, builder, sig, args):
        def join(a, b):
            return builder.select(builder.fcmp_ordered(">", a, b), a, b)

        return _reduced(builder, args[0], join)

    return types.float64(vector), codegen


@intrinsic
def lane_of(typingctx, vector, value):
    """The first lane that holds `value`; LANES or more if none does."""

    def codegen(context, builder, sig, args):
        vector, value = args
        spread = ir.Constant(vector.type, ir.Undefined)
        spread = builder.insert_element(spread, value, ir.Constant(ir.IntType(32), 0))
        order = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        spread = builder.shuffle_vector(spread, spread, order)
        bits = builder.bitcast(builder.fcmp_ordered("==", vector, spread), ir.IntType(LANES))
        bits = builder.zext(bits, INT64)
        return builder.cttz(
            builder.or_(bits, ir.Constant(INT64, 1 << LANES)), ir.Constant(ir.IntType(1), 0)
        )

    return types.int64(Vec(LANES), types.float64), codegen
