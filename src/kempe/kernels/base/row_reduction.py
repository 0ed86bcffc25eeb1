"""Reductions of a vector to one number: the sum of its entries, the largest entry, and the place of
an entry.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types

from kempe.kernels.base.vectors import INT64, LANES, Vec, intrinsic


def _split_halves(builder, value):
    """Split a vector into its lower and its upper half."""
    width = value.type.count // 2
    for start in (0, width):
        order = ir.Constant(ir.VectorType(ir.IntType(32), width), list(range(start, start + width)))
        yield builder.shuffle_vector(value, value, order)


def _reduce_vector(builder, value, join):
    """Join the halves of a vector until one entry is left, and return it."""
    while value.type.count > 1:
        value = join(*_split_halves(builder, value))
    return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))


@intrinsic
def sum_entries(typingctx, vector):
    """Return the sum of a vector's entries, halves added first."""

    def emit_code(context, builder, sig, args):
        return _reduce_vector(builder, args[0], builder.fadd)

    return types.float64(vector), emit_code


@intrinsic
def find_maximum(typingctx, vector):
    """Return the largest entry of a vector without NaN."""

    def emit_code(context, builder, sig, args):
        def select_larger(a, b):
            return builder.select(builder.fcmp_ordered(">", a, b), a, b)

        return _reduce_vector(builder, args[0], select_larger)

    return types.float64(vector), emit_code


@intrinsic
def find_lane(typingctx, vector, value):
    """Return the first lane that holds `value`; LANES or more if no lane does."""

    def emit_code(context, builder, sig, args):
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

    return types.int64(Vec(LANES), types.float64), emit_code
