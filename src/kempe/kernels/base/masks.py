"""Truth values of lanes as numbers: what a loop has to branch on."""

from __future__ import annotations

from llvmlite import ir
from numba import types

from kempe.kernels.base.vectors import Mask, intrinsic


@intrinsic
def pack_mask(typingctx, mask):
    """Pack the truth values of the lanes into one whole number: bit l is the value of lane l."""
    if not isinstance(mask, Mask):
        return None

    def emit_code(context, builder, sig, args):
        whole = builder.bitcast(args[0], ir.IntType(sig.args[0].width))
        return builder.zext(whole, ir.IntType(64))

    return types.int64(mask), emit_code
