"""Pointers into one block of scratch memory, since a kernel allocates once, and copies inside the
block.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types

from kempe.kernels.base._jit import device
from kempe.kernels.base.vectors import intrinsic


@intrinsic
def advance_pointer(typingctx, pointer, count):
    """Return the pointer to the number that lies `count` numbers after the one that `pointer`
    points to.
    """

    def emit_code(context, builder, sig, args):
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, types.int64), emit_code


ALIGNMENT = 64
"""Bytes of the widest register: vectors that straddle such a border cost two accesses."""


@intrinsic
def align_pointer(typingctx, pointer):
    """Return the first aligned address at or after the pointer; up to 7 numbers are skipped."""

    def emit_code(context, builder, sig, args):
        whole = ir.IntType(64)
        place = builder.add(builder.ptrtoint(args[0], whole), ir.Constant(whole, ALIGNMENT - 1))
        return builder.inttoptr(builder.and_(place, ir.Constant(whole, -ALIGNMENT)), args[0].type)

    return pointer(pointer), emit_code


@device
def copy_numbers(target, source, start, count):
    """Copy the numbers source[start : start + count] to the same places of target."""
    for k in range(count):
        target[k] = source[start + k]
