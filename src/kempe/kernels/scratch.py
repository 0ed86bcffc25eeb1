"""Pointers into one block of scratch: a kernel allocates once."""

from __future__ import annotations

from numba import types

from kempe.kernels.vectors import intrinsic


@intrinsic
def beyond(typingctx, pointer, count):
    """The pointer to what lies `count` numbers after where `pointer` points."""

    def codegen(context, builder, sig, args):
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, types.int64), codegen
