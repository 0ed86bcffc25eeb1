"""Pointers into one block of scratch, for which Numba has no words."""

from __future__ import annotations

from numba import types
from numba.extending import intrinsic


@intrinsic
def beyond(typingctx, pointer, count):
    """The pointer to what lies `count` numbers after where `pointer` points."""

    def codegen(context, builder, sig, args):
        return builder.gep(args[0], [args[1]])

    return pointer(pointer, types.int64), codegen
