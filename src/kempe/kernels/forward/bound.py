"""One frame at one configuration, for bound queries: the table comes as one array.

Each array that is handed over costs time that counts beside a few joints. So the integers of a
table travel in the same array as its numbers, as the same bytes, and with them the frame in which a
Jacobian is expressed: `fuse`. Wrong shapes are reported, not refused: the caller then takes the
general way.
"""

from __future__ import annotations

from numba import types

from kempe.kernels.base._jit import kernel
from kempe.kernels.base.declare import OUT, F
from kempe.kernels.base.vectors import intrinsic, raw
from kempe.kernels.forward.table_layout import (
    FRAME,
    NQ,
    NV,
    SIZE,
)
from kempe.kernels.forward.table_sweep import jacobian_at, pose_at


@intrinsic
def integers(typingctx, pointer):
    """The same pointer, to integers."""
    to = types.CPointer(types.int64)

    def codegen(context, builder, sig, args):
        return builder.bitcast(args[0], context.get_value_type(to))

    return to(pointer), codegen


@intrinsic
def after(typingctx, pointer, count):
    """Pointer to the entry that is `count` further."""

    def codegen(context, builder, sig, args):
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, count), codegen


@kernel(F("_"), F("_"), OUT("_", "_"), nogil=False)
def pose(table, q, out):
    """Number of bad configurations, 0 or 1; writes the pose (4, 4) of the first output at q (nq,).
    -1: wrong shapes.
    """
    numbers = raw(table)
    ints = integers(numbers)
    if q.shape[0] != ints[NQ] or out.shape[0] != 4 or out.shape[1] != 4:
        return -1
    return pose_at(ints, after(numbers, ints[SIZE]), raw(q), 0, raw(out), 0)


@kernel(F("_"), F("_"), OUT("_", "_"), nogil=False)
def jacobian(table, q, columns):
    """Number of bad configurations, 0 or 1; writes the Jacobian (6, nv) of the first output.

    Rows: linear, angular. A bad configuration makes all columns NaN. -1: wrong shapes, or columns
    that lie over q, which are written before all of q is read.
    """
    numbers = raw(table)
    j = raw(columns)
    ints = integers(numbers)
    if q.shape[0] != ints[NQ] or columns.shape[0] != 6 or columns.shape[1] != ints[NV]:
        return -1
    here = q.ctypes.data
    there = columns.ctypes.data
    if here < there + 8 * columns.size and there < here + 8 * q.size:
        return -1
    return jacobian_at(ints, after(numbers, ints[SIZE]), raw(q), 0, ints[FRAME], False, j, 0, j, 0)


@kernel(F("_"), F("_"), OUT("_", "_"), OUT("_", "_"), nogil=False)
def pose_jacobian(table, q, out, columns):
    """As `pose` and `jacobian` together."""
    numbers = raw(table)
    ints = integers(numbers)
    if q.shape[0] != ints[NQ] or columns.shape[0] != 6 or columns.shape[1] != ints[NV]:
        return -1
    if out.shape[0] != 4 or out.shape[1] != 4:
        return -1
    return jacobian_at(
        ints, after(numbers, ints[SIZE]), raw(q), 0, ints[FRAME], True, raw(out), 0, raw(columns), 0
    )
