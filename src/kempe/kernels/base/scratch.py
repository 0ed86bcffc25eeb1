"""Scratch: pointers into one block, for a kernel allocates once, and copies of what lies in it."""

from __future__ import annotations

from llvmlite import ir
from numba import types

from kempe.kernels.base._jit import device
from kempe.kernels.base.vectors import intrinsic


@intrinsic
def beyond(typingctx, pointer, count):
    """The pointer to what lies `count` numbers after where `pointer` points."""

    def codegen(context, builder, sig, args):
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, types.int64), codegen


ALIGNMENT = 64
"""Bytes of the widest register: vectors that straddle such a border cost two accesses."""


@intrinsic
def aligned(typingctx, pointer):
    """The first place from where the pointer points on that lies at a border; up to 7 numbers are
    passed over.
    """

    def codegen(context, builder, sig, args):
        whole = ir.IntType(64)
        place = builder.add(builder.ptrtoint(args[0], whole), ir.Constant(whole, ALIGNMENT - 1))
        return builder.inttoptr(builder.and_(place, ir.Constant(whole, -ALIGNMENT)), args[0].type)

    return pointer(pointer), codegen


@device
def copy(target, source, start, count):
    """Copy source[start : start + count]."""
    for k in range(count):
        target[k] = source[start + k]
