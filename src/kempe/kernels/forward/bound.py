"""One frame at one configuration, for bound queries: the table comes as one array.

Each array that is handed over costs time that counts beside a few joints. So the integers of a
table travel in the same array as its numbers, as the same bytes, and with them the frame in which a
Jacobian is expressed: `fuse_table`. Wrong shapes are reported, not refused: the caller then takes
the general way.
"""

from __future__ import annotations

from numba import types

from kempe.kernels.base._jit import kernel
from kempe.kernels.base.declare import OUT, F
from kempe.kernels.base.vectors import get_pointer, intrinsic
from kempe.kernels.forward.table_layout import (
    FRAME,
    NQ,
    NV,
    SIZE,
)
from kempe.kernels.forward.table_sweep import evaluate_jacobian, evaluate_pose


@intrinsic
def cast_to_integers(typingctx, pointer):
    """Return the same pointer as a pointer to integers."""
    to = types.CPointer(types.int64)

    def emit_code(context, builder, sig, args):
        return builder.bitcast(args[0], context.get_value_type(to))

    return to(pointer), emit_code


@intrinsic
def advance_integer_pointer(typingctx, pointer, count):
    """Return the pointer to the entry that is `count` further."""

    def emit_code(context, builder, sig, args):
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, count), emit_code


@kernel(F("_"), F("_"), OUT("_", "_"), nogil=False)
def compute_pose(table, q, out):
    """Write the pose (4, 4) of the first output at q (nq,); return the number of bad
    configurations, 0 or 1, or -1 for wrong shapes.
    """
    numbers = get_pointer(table)
    ints = cast_to_integers(numbers)
    if q.shape[0] != ints[NQ] or out.shape[0] != 4 or out.shape[1] != 4:
        return -1
    return evaluate_pose(
        ints, advance_integer_pointer(numbers, ints[SIZE]), get_pointer(q), 0, get_pointer(out), 0
    )


@kernel(F("_"), F("_"), OUT("_", "_"), nogil=False)
def compute_jacobian(table, q, columns):
    """Write the Jacobian (6, nv) of the first output; return the number of bad configurations, 0 or
    1.

    Rows: linear, angular. A bad configuration makes all columns NaN. -1: wrong shapes, or columns
    that lie over q, which are written before all of q is read.
    """
    numbers = get_pointer(table)
    j = get_pointer(columns)
    ints = cast_to_integers(numbers)
    if q.shape[0] != ints[NQ] or columns.shape[0] != 6 or columns.shape[1] != ints[NV]:
        return -1
    here = q.ctypes.data
    there = columns.ctypes.data
    if here < there + 8 * columns.size and there < here + 8 * q.size:
        return -1
    return evaluate_jacobian(
        ints,
        advance_integer_pointer(numbers, ints[SIZE]),
        get_pointer(q),
        0,
        ints[FRAME],
        False,
        j,
        0,
        j,
        0,
    )


@kernel(F("_"), F("_"), OUT("_", "_"), OUT("_", "_"), nogil=False)
def compute_pose_jacobian(table, q, out, columns):
    """Write the pose and the Jacobian, as `compute_pose` and `compute_jacobian` do."""
    numbers = get_pointer(table)
    ints = cast_to_integers(numbers)
    if q.shape[0] != ints[NQ] or columns.shape[0] != 6 or columns.shape[1] != ints[NV]:
        return -1
    if out.shape[0] != 4 or out.shape[1] != 4:
        return -1
    return evaluate_jacobian(
        ints,
        advance_integer_pointer(numbers, ints[SIZE]),
        get_pointer(q),
        0,
        ints[FRAME],
        True,
        get_pointer(out),
        0,
        get_pointer(columns),
        0,
    )
